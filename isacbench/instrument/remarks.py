"""Remarks of an estimator on an image: counts of cases that the data leave undecided.

A remark is neither an error nor a warning: the image is valid, and undecided cases
are left out of it. Remarks are counted within `Remarks`, and ignored elsewhere.
Estimators of other packages may make the same remarks:

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

from isacbench.errors import require_known

Remark = Literal["unseparated", "crowded", "unexplained"]
"""Known remarks.

unseparated
    Subspaces that rounding decides about: at the order asked for, signal and
    noise are not separated (`isacbench.dsp.angles.line_subspaces`).
    Directions come from the dimensions that are determined, if any.
crowded
    Atoms beyond the largest number that an estimator fits together: the weakest
    ones, left out.
unexplained
    Maps of whose energy an estimator's model leaves a large share: the image is
    made in another way, which the estimator's page names.
"""

REMARKS: tuple[Remark, ...] = get_args(Remark)

_SENTENCES: dict[Remark, str] = {
    "unseparated": "subspaces: signal and noise not separated, no direction taken from them",
    "crowded": "atoms: beyond the limit of those fitted together, left out",
    "unexplained": "maps: not explained by atoms, imaged in another way",
}

_current: ContextVar[Remarks | None] = ContextVar("current", default=None)
"""Present counter of remarks. It belongs to the context: threads that an estimator starts have none."""


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
    """Counter of the remarks made within it; a context manager. If two are nested, only the inner one counts.

    Attributes
    ----------
    counts : dict of str to Count
        Count of each remark that was made.
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
        """Write one sentence for each remark with at least one case."""
        return [
            f"{count.n} of {count.of} {_SENTENCES[name]}" for name, count in self.counts.items() if count.n
        ]


def remark(name: Remark, n: int, of: int) -> None:
    """Report n cases out of those examined, if a `Remarks` is active.

    Parameters
    ----------
    name : {"unseparated"}
        See `Remark`.
    n, of : int
        Cases that the remark is about, and cases examined. Call it with n = 0,
        too, so that all examined cases are counted.

    Raises
    ------
    InputError
        If there is no such remark.
    """
    require_known("remark", name, REMARKS)
    remarks = _current.get()
    if remarks is not None:
        before = remarks.counts.get(name, Count(0, 0))
        remarks.counts[name] = Count(before.n + n, before.of + of)
