"""Stages of an estimate: where its time goes, told by the estimator itself.

An estimator wraps its steps in `stage`. As long as nobody measures this costs
a fraction of a microsecond; within a `StageClock` every stage collects its time.
Estimators of other packages may do the same:

>>> from isacbench.instrument.stages import stage
>>> def estimate(observation):
...     with stage("rdm"):
...         cells = observation.cells
...     with stage("detection"):
...         ...
"""

from __future__ import annotations

import time
from contextvars import ContextVar
from typing import TYPE_CHECKING, Literal, Protocol, Self, get_args

from isacbench.errors import unknown_name

if TYPE_CHECKING:
    from collections.abc import Callable
    from contextvars import Token
    from types import TracebackType

Stage = Literal["rdm", "detection", "subspace", "spectrum", "peaks", "refinement"]
"""Steps of an estimate, in the order of the chain.

rdm
    Reading and tapering range-Doppler cells, whatever makes maps.
detection
    Power map, noise and floors, CFAR over range-Doppler cells.
subspace
    Covariances, eigendecompositions, orders.
spectrum
    Spectra over directions: MUSIC, Fourier transforms over the array, beams.
peaks
    Peaks of spectra with their test, pairing, directions without a spectrum,
    places in range and Doppler.
refinement
    Joint selection, Newton and maximum likelihood.
"""

STAGES: tuple[Stage, ...] = get_args(Stage)

_ALLOWED = frozenset(STAGES)

_current: ContextVar[StageClock | None] = ContextVar("current", default=None)
"""The clock that measures; of the context, so that threads which an estimator starts have none."""


class _Marker(Protocol):
    """What `stage` returns."""

    def __enter__(self) -> None:
        """Begin."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End; exceptions pass."""


class _Unmeasured:
    """A stage that nobody measures."""

    def __enter__(self) -> None:
        pass

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass


class _Measured:
    """A stage whose time a clock collects."""

    def __init__(self, clock: StageClock, name: Stage) -> None:
        self._clock, self._name = clock, name

    def __enter__(self) -> None:
        self._clock._begin(self._name)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._clock._end()


class StageClock:
    """Wall time of what runs within it, as a whole and by stage; a context manager, entered once.

    Times of stages are exclusive: while an inner stage runs, the outer one's
    stands still. Threads that an estimator starts have no clock of their own:
    the stage that waits for them has their time. Of two clocks, one within
    the other, the inner one alone sees the stages that run in it.

    Parameters
    ----------
    now : callable, optional
        Time in s.

    Attributes
    ----------
    seconds : dict of str to float
        Time in s of each stage that occurred.
    total_s : float
        From entering to leaving, what belongs to no stage included.

    Examples
    --------
    >>> ticks = iter([0.0, 1.0, 2.0, 5.0, 6.0, 10.0])
    >>> with StageClock(now=lambda: next(ticks)) as clock:
    ...     with stage("peaks"):
    ...         with stage("spectrum"):
    ...             pass
    >>> clock.seconds, clock.total_s
    ({'peaks': 2.0, 'spectrum': 3.0}, 10.0)
    """

    def __init__(self, now: Callable[[], float] = time.perf_counter) -> None:
        self.seconds: dict[Stage, float] = {}
        self.total_s = 0.0
        self._now = now
        self._running: list[Stage] = []
        self._since = self._start = 0.0
        self._token: Token[StageClock | None] | None = None

    def __enter__(self) -> Self:
        self._token = _current.set(self)
        self._start = self._now()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.total_s = self._now() - self._start
        assert self._token is not None
        _current.reset(self._token)

    def _begin(self, name: Stage) -> None:
        now = self._now()
        if self._running:
            self.seconds[self._running[-1]] += now - self._since
        self.seconds.setdefault(name, 0.0)
        self._running.append(name)
        self._since = now

    def _end(self) -> None:
        now = self._now()
        self.seconds[self._running.pop()] += now - self._since
        self._since = now


_unmeasured = _Unmeasured()


def stage(name: Stage) -> _Marker:
    """Mark a stage of an estimate; a context manager.

    Parameters
    ----------
    name : {"rdm", "detection", "subspace", "spectrum", "peaks", "refinement"}
        See `Stage`.

    Raises
    ------
    InputError
        If there is no such stage.
    """
    if name not in _ALLOWED:
        raise unknown_name("stage", name, STAGES)
    clock = _current.get()
    return _unmeasured if clock is None else _Measured(clock, name)
