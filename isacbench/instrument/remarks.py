"""Remarks of an estimator on an image: places where the data leave something open.

A remark is no error and no warning: the image is valid, and what is open is left
out of it. Remarks are counted within `Remarks`, and ignored elsewhere.
Estimators of other packages may remark the same:

>>> from isacbench.instrument.remarks import Remarks, remark
>>> with Remarks() as remarks:
...     remark("unseparated", 2, 40)
...     remark("unseparated", 0, 40)
>>> remarks.sentences()
['2 of 80 subspaces: signal and noise not separated, no direction taken from them']
"""

from __future__ import annotations

from contextvars import ContextVar
from typing import Literal, NamedTuple, Self, get_args

from isacbench.errors import unknown_name

Remark = Literal["unseparated"]
"""Remarks that there are.

unseparated
    Subspaces whose dimensions depend on rounding: at the order asked for,
    signal and noise are not separated (`isacbench.dsp.angles.eigenpairs`).
    Directions come from the dimensions that are determined, if any.
"""

REMARKS: tuple[Remark, ...] = get_args(Remark)

_SENTENCES: dict[Remark, str] = {
    "unseparated": "subspaces: signal and noise not separated, no direction taken from them"
}

_current: ContextVar[Remarks | None] = ContextVar("current", default=None)
"""Counter of remarks. It belongs to the context: threads that an estimator starts have none."""


class Count(NamedTuple):
    """Count of a remark.

    Attributes
    ----------
    n : int
        Cases that the remark is about.
    of : int
        Cases that were examined.
    """

    n: int
    of: int


class Remarks:
    """Counter of the remarks within it; a context manager. Of two nested ones only the inner one counts.

    Attributes
    ----------
    counts : dict of str to Count
        Of each remark that was made.
    """

    def __init__(self) -> None:
        self.counts: dict[Remark, Count] = {}
        self._outer: Remarks | None = None

    def __enter__(self) -> Self:
        self._outer = _current.get()
        _current.set(self)
        return self

    def __exit__(self, *_: object) -> None:
        _current.set(self._outer)

    def sentences(self) -> list[str]:
        """Write one sentence for each remark of which there were cases."""
        return [
            f"{count.n} of {count.of} {_SENTENCES[name]}" for name, count in self.counts.items() if count.n
        ]


def remark(name: Remark, n: int, of: int) -> None:
    """Remark on n cases out of many, if a `Remarks` counts.

    Parameters
    ----------
    name : {"unseparated"}
        See `Remark`.
    n, of : int
        Cases that the remark is about, and cases examined. Also remark with n = 0,
        so that all examined cases count.

    Raises
    ------
    InputError
        If there is no such remark.
    """
    if name not in _SENTENCES:
        raise unknown_name("remark", name, REMARKS)
    remarks = _current.get()
    if remarks is not None:
        before = remarks.counts.get(name, Count(0, 0))
        remarks.counts[name] = Count(before.n + n, before.of + of)
