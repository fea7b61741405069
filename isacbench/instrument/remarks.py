"""What an estimator has to say about an image beside its cloud: where the data leave something open.

A remark is no error and no warning: the image is taken, and what was open is
left out of it. Nobody need listen. Within `Remarks` they are counted.
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
from typing import TYPE_CHECKING, Literal, NamedTuple, Self, get_args

from isacbench.errors import unknown_name

if TYPE_CHECKING:
    from contextvars import Token
    from types import TracebackType

Remark = Literal["unseparated"]
"""What can be remarked.

unseparated
    Subspaces of whose dimensions rounding has the choice: at the order asked
    for, signal and noise are not separated (`isacbench.dsp.angles.eigenpairs`).
    Directions come from the dimensions that are determined, if any.
"""

REMARKS: tuple[Remark, ...] = get_args(Remark)

_SENTENCES: dict[Remark, str] = {
    "unseparated": "subspaces: signal and noise not separated, no direction taken from them"
}

_current: ContextVar[Remarks | None] = ContextVar("current", default=None)
"""Who listens; of the context, so that threads which an estimator starts are not heard."""


class Count(NamedTuple):
    """How many of how many.

    Attributes
    ----------
    n : int
        Those that the remark is about.
    of : int
        Those that were looked at.
    """

    n: int
    of: int


class Remarks:
    """Counts the remarks that are made within it; a context manager. Of two, the inner one alone hears them.

    Attributes
    ----------
    counts : dict of str to Count
        Of each remark that was made.
    """

    def __init__(self) -> None:
        self.counts: dict[Remark, Count] = {}
        self._token: Token[Remarks | None] | None = None

    def __enter__(self) -> Self:
        self._token = _current.set(self)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._token is not None
        _current.reset(self._token)

    def add(self, name: Remark, n: int, of: int) -> None:
        """Count more of them."""
        before = self.counts.get(name, Count(0, 0))
        self.counts[name] = Count(before.n + n, before.of + of)

    def sentences(self) -> list[str]:
        """One sentence for each remark that is about anything."""
        return [
            f"{count.n} of {count.of} {_SENTENCES[name]}" for name, count in self.counts.items() if count.n
        ]


def remark(name: Remark, n: int, of: int) -> None:
    """Say that something is so of n out of many; costs nothing to speak of where nobody listens.

    Parameters
    ----------
    name : {"unseparated"}
        See `Remark`.
    n, of : int
        How many of how many; 0 of them count as looked at.

    Raises
    ------
    InputError
        If there is no such remark.
    """
    if name not in _SENTENCES:
        raise unknown_name("remark", name, REMARKS)
    remarks = _current.get()
    if remarks is not None:
        remarks.add(name, n, of)
