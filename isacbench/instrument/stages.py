"""Stages of an estimate: steps that the estimator marks, so that they are timed.

An estimator wraps its steps in `stage`. Within a `StageClock` every stage
collects its time; without one a stage costs a fraction of a microsecond.
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
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from typing import Literal, Self, get_args

from isacbench.errors import require_known

Stage = Literal["rdm", "detection", "subspace", "spectrum", "peaks", "refinement"]
"""Steps of an estimate, in the order of the chain.

rdm
    Reading and tapering range-Doppler cells.
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

_current: ContextVar[StageClock | None] = ContextVar("current", default=None)
"""Clock that measures. It belongs to the context: threads that an estimator starts have none."""


class StageClock:
    """Clock of the processor time within it, as a whole and by stage; a context manager, entered once.

    Times of stages are exclusive: an inner stage stops the outer one. Threads
    that an estimator starts have no clock: their time counts for the stage
    that waits for them. Of two nested clocks only the inner one sees the
    stages within it.

    Parameters
    ----------
    now : callable, optional
        Time in s; by default that of the process's processors.

    Attributes
    ----------
    seconds : dict of str to float
        Time in s of each stage that occurred.
    total_s : float
        Time from entering to leaving, inside and outside of stages.
    """

    def __init__(self, now: Callable[[], float] = time.process_time) -> None:
        self.seconds: dict[Stage, float] = {}
        self.total_s = 0.0
        self._now = now
        self._running: list[Stage] = []
        self._since = self._start = 0.0
        self._outer: StageClock | None = None

    def __enter__(self) -> Self:
        self._outer = _current.get()
        _current.set(self)
        self._start = self._now()
        return self

    def __exit__(self, *_: object) -> None:
        self.total_s = self._now() - self._start
        _current.set(self._outer)

    @contextmanager
    def _running_stage(self, name: Stage) -> Iterator[None]:
        """Give a stage the time that passes within it."""
        self._account()
        self.seconds.setdefault(name, 0.0)
        self._running.append(name)
        try:
            yield
        finally:
            self._account()
            self._running.pop()

    def _account(self) -> None:
        """Give the time since the last call to the stage that is running."""
        now = self._now()
        if self._running:
            self.seconds[self._running[-1]] += now - self._since
        self._since = now


def stage(name: Stage) -> AbstractContextManager[None]:
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
    require_known("stage", name, STAGES)
    clock = _current.get()
    return nullcontext() if clock is None else clock._running_stage(name)
