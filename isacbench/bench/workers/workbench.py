"""The workbench: what one process needs to work off blocks, with the current observation at hand."""

from __future__ import annotations

import copy
import time
from functools import partial
from typing import TYPE_CHECKING, Any

from isacbench.bench.cells.cell import run_cell
from isacbench.bench.cells.isolation import seed_global_generators
from isacbench.bench.cells.record import Row
from isacbench.bench.cells.statuses import SCORED
from isacbench.bench.cells.timing import repeat
from isacbench.bench.store.provenance import environment_id, environment_of
from isacbench.cores import one_blas_thread
from isacbench.process_state import process_state_kept

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator, Sequence

    from isacbench.bench.cells.cell import Found
    from isacbench.bench.kinds.scenes import Entry, Scene, SharedObservation
    from isacbench.bench.plan.job import Job
    from isacbench.bench.plan.run_plan import Block
    from isacbench.bench.store.provenance import Environment

CHANGED = "ValueError: it changed the observation, which is read-only and which others meet as well"


class Workbench:
    """Scenes of a job in this process, out of reach of the plugins that work on them.

    With `repeats` each estimate is timed (`isacbench.bench.cells.timing`); without it times do not count.
    """

    def __init__(self, job: Job, repeats: int | None = None) -> None:
        # Plugins see a copy, and the next ones a fresh copy should they have changed it. Classes are not
        # copied: in this process they are the caller's.
        self.job, self._repeats = copy.deepcopy(job), repeats
        self._scenes: Sequence[Scene] = ()
        self._scene: Scene | None = None
        self._block: Block
        self._shared: SharedObservation
        self._digest = ""
        self._environments: dict[tuple[str, str], Environment] = {}

    @one_blas_thread()
    def observe(self, block: Block) -> dict[int, Row]:
        """Observe what the cells of a block share; return the row of each as far as it is known by now."""
        if not self._scenes:
            self._scenes = copy.deepcopy(self.job).plan.scenes
        scene = self._scenes[block.scene]
        if self._scene is not scene and self._scene is not None:
            self._scene.forget()
        self._scene, self._block, self._shared = scene, block, scene.observe(block.snr_db, block.trial)
        self._digest = self._shared.digest()
        return {entry: self.row(entry) for entry in block.entries}

    def row(self, entry: int) -> Row:
        """Row of an entry of the scene that was observed last, before it has worked on the observation."""
        chosen, shared = self._entry(entry), self._shared
        key = chosen.name, chosen.params
        if key not in self._environments:
            self._environments[key] = environment_of(chosen.plugin)
        environment = self._environments[key]
        known = {
            **shared.labels,
            **chosen.labels,
            **shared.key,
            "estimator": chosen.name,
            "params": chosen.params,
            "n_true": shared.n_true,
            "n_estimated": 0,
            "timing": self._repeats is not None,
            "environment": environment_id(environment),
        }
        return Row(known, environment)

    def is_to_time(self, row: Row) -> bool:
        """Tell whether an estimate is to be repeated: times count, and it has delivered."""
        return self._repeats is not None and row.status in SCORED

    def image(self, entry: int, first: Row | None = None) -> Row:
        """Let an entry of the scene that was observed last work on the observation, and return its row.

        If it has changed the observation, which is read-only, that is a failure, and the observation is made
        anew for the others. If `first` is its row, repeats of the same are timed.
        """
        chosen, block = self._entry(entry), self._block
        row = self.row(entry) if first is None else first
        key = self._scenes[block.scene].name, block.trial, block.snr_db, chosen.name, chosen.params
        seed_generators = partial(seed_global_generators, self.job.suite.seed, *key)
        start = time.perf_counter()
        with process_state_kept(), one_blas_thread():
            if first is None:
                seed_generators()
                row = run_cell(row, partial(self._shared.work, chosen.plugin))
            else:
                row = run_cell(row, partial(self._time_repeats, chosen.plugin, first, seed_generators))
        if self._is_unchanged():
            return row
        row = row.failed("error", CHANGED, time.perf_counter() - start)
        self.start_over()
        return row

    def start_over(self) -> None:
        """Make anew what was observed last, and all that it was made from."""
        self._scenes, self._scene = (), None
        self.observe(self._block)

    def work(self, block: Block) -> Iterator[Row]:
        """Work off a block, without any guard."""
        self.observe(block)
        for entry in block.entries:
            row = self.image(entry)
            yield self.image(entry, row) if self.is_to_time(row) else row

    def _time_repeats(self, plugin: Any, first: Row, before_each: Callable[[], None]) -> Found:
        """Columns of a row with the times of repeats, or of a failure if they give another result."""
        assert self._repeats is not None

        def prepare() -> SharedObservation:
            before_each()
            return self._shared.unread()

        answers, columns = repeat(prepare, lambda shared: shared.call(plugin), self._repeats)
        if differing := self._shared.n_differing(answers, first):
            reason = (
                f"{differing} of {len(answers)} repeats of the same estimate gave another result; "
                "only what repeats itself can be timed"
            )
            failure = first.failed("error", reason, columns["time_estimate_s"])
            return failure.found, failure.cloud
        return {**first.found, **columns}, first.cloud

    def _is_unchanged(self) -> bool:
        """Tell whether the next entry is shown what the last one was."""
        try:
            return self._shared.digest() == self._digest
        except Exception:  # an array may have become anything
            return False

    def _entry(self, entry: int) -> Entry[Any]:
        """Entry by its index in the whole plan, of which this process may have a part."""
        name, params, _ = self.job.keys[self._block.scene][entry]
        entries = self._scenes[self._block.scene].entries
        return next(one for one in entries if (one.name, one.params) == (name, params))


def work_here(job: Job, blocks: Sequence[Block], repeats: int | None = None) -> Generator[Row, None, None]:
    """Work off blocks in this process: easy to debug, but a plugin that hangs or dies takes all with it."""
    workbench = Workbench(job, repeats)
    for block in blocks:
        yield from workbench.work(block)
