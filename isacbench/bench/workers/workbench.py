"""The workbench: what one process needs to work off blocks, with the current observation at hand."""

from __future__ import annotations

import copy
import time
from functools import partial
from typing import TYPE_CHECKING, Any

from isacbench.bench.cells.isolation import seed_global_generators
from isacbench.bench.cells.statuses import SCORED
from isacbench.bench.store.provenance import Made, environment_id, environment_of
from isacbench.cores import one_blas_thread
from isacbench.process_state import process_state_kept

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from isacbench.bench.cells.record import CellStatus, Outcome
    from isacbench.bench.kinds.scenes import Entry, Scene, SharedObservation
    from isacbench.bench.plan.job import Job
    from isacbench.bench.plan.run_plan import Block
    from isacbench.bench.store.provenance import Environment

CHANGED = "ValueError: it changed the observation, which is read-only and which others meet as well"


def is_to_time(made: Made, repeats: int | None) -> bool:
    """Tell whether an estimate is to be repeated: times count, and it has delivered.

    Parameters
    ----------
    made : Made
        Outcome of its first call.
    repeats : int, optional
        Number of repeats; without it times do not count.
    """
    return repeats is not None and made.outcome.record.status in SCORED


class Workbench:
    """Scenes of a job in this process, out of reach of the plugins that they meet.

    Parameters
    ----------
    repeats : int, optional
        How often each estimate is timed (`isacbench.bench.cells.timing`); without it
        times do not count.
    """

    def __init__(self, job: Job, repeats: int | None = None) -> None:
        # Plugins see a copy, and the next ones a fresh copy should they have changed it. Classes are not
        # copied: in this process they are the caller's.
        self._job = copy.deepcopy(job)
        self._seed, self._repeats = job.suite.seed, repeats
        self._scenes = self._fresh_scenes()
        self._scene: Scene | None = None
        self._block: Block
        self._shared: SharedObservation
        self._digest = ""
        self._environments: dict[tuple[str, str], tuple[str, Environment]] = {}

    @one_blas_thread()
    def observe(self, block: Block) -> list[Made]:
        """Observe what the cells of a block share.

        Returns
        -------
        list of Made
            A row for each of the block's cells, in case that it leaves no
            other trace.
        """
        scene = self._scenes[block.scene]
        if self._scene is not scene and self._scene is not None:
            self._scene.forget()
        self._scene, self._block, self._shared = scene, block, scene.observe(block.snr_db, block.trial)
        self._digest = self._shared.digest()
        return [self.failure_row(entry, "killed", "", 0.0) for entry in block.entries]

    def image(self, entry: int) -> Made:
        """Let an entry of the scene that was observed last meet the observation.

        Parameters
        ----------
        entry : int
            Index of the entry in the scene.

        Returns
        -------
        Made
            A failure if it changed the observation, which is read-only and
            is then made anew for the others.
        """

        def meet(chosen: Entry[Any], seed_generators: Callable[[], None]) -> Outcome:
            seed_generators()
            return self._shared.meet(chosen)

        return self._watched(entry, meet)

    def time_repeats(self, entry: int, met: Made) -> Made:
        """Time repeats of what an entry of that scene has made of the observation.

        Parameters
        ----------
        met : Made
            Outcome of `image`.
        """

        def meet_again(chosen: Entry[Any], seed_generators: Callable[[], None]) -> Outcome:
            assert self._repeats is not None
            return self._shared.time_repeats(chosen, met.outcome, self._repeats, seed_generators)

        return self._watched(entry, meet_again)

    def failure_row(self, entry: int, status: CellStatus, reason: str, time_s: float) -> Made:
        """Make the row of an entry of the scene that was observed last, should it leave no other trace.

        Parameters
        ----------
        time_s : float
            Time until the failure in s.
        """
        chosen = self._entry(entry)
        return self._made(self._shared.failure_row(chosen, status, reason, time_s), chosen)

    def start_over(self) -> None:
        """Make anew what was observed last, and all that it was made from."""
        self._scenes, self._scene = self._fresh_scenes(), None
        self.observe(self._block)

    def work(self, block: Block) -> Iterator[Made]:
        """Work off a block, without any guard."""
        self.observe(block)
        for entry in block.entries:
            made = self.image(entry)
            yield self.time_repeats(entry, made) if is_to_time(made, self._repeats) else made

    def _watched(self, entry: int, act: Callable[[Entry[Any], Callable[[], None]], Outcome]) -> Made:
        """Let an entry act; give it a function that seeds what generators all plugins share."""
        chosen, block = self._entry(entry), self._block
        key = self._scenes[block.scene].name, block.trial, block.snr_db, chosen.name, chosen.params
        start = time.perf_counter()
        with process_state_kept(), one_blas_thread():
            outcome = act(chosen, partial(seed_global_generators, self._seed, *key))
        if self._is_unchanged():
            return self._made(outcome, chosen)
        made = self.failure_row(entry, "error", CHANGED, time.perf_counter() - start)
        self.start_over()
        return made

    def _is_unchanged(self) -> bool:
        """Tell whether the next entry is shown what the last one was."""
        try:
            return self._shared.digest() == self._digest
        except Exception:  # an array may have become anything
            return False

    def _fresh_scenes(self) -> Sequence[Scene]:
        return copy.deepcopy(self._job).plan.scenes

    def _entry(self, entry: int) -> Entry[Any]:
        """Entry by its index in the whole plan, of which this process may have a part."""
        name, params, _ = self._job.keys[self._block.scene][entry]
        entries = self._scenes[self._block.scene].entries
        return next(one for one in entries if (one.name, one.params) == (name, params))

    def _made(self, outcome: Outcome, entry: Entry[Any]) -> Made:
        """Outcome with the environment in which its entry runs here."""
        key = entry.name, entry.params
        if key not in self._environments:
            environment = environment_of(entry.plugin)
            self._environments[key] = environment_id(environment), environment
        name, environment = self._environments[key]
        return Made(outcome.made_by(name, timing=self._repeats is not None), environment)
