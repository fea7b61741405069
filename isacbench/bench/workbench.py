"""The workbench: what one process needs to work off blocks, with the current observation at hand."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from isacbench.bench.provenance import environment_id, environment_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from isacbench.bench.job import Job
    from isacbench.bench.plan import Block
    from isacbench.bench.provenance import Environment
    from isacbench.bench.record import Outcome
    from isacbench.bench.study import Contestant, Encounter, Scene

__all__ = ["Made", "Workbench"]


class Made(NamedTuple):
    """An outcome, and the environment that made it, whose name the record has."""

    outcome: Outcome
    environment: Environment


class Workbench:
    """Scenes of a job in this process.

    Parameters
    ----------
    job : Job
    """

    def __init__(self, job: Job) -> None:
        self._scenes = job.plan.scenes
        self._scene: Scene | None = None
        self._encounter: Encounter | None = None
        self._environments: dict[tuple[str, str], tuple[str, Environment]] = {}

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
        self._scene, self._encounter = scene, scene.observe(block.snr_db, block.trial)
        contestants = [scene.contestants[index] for index in block.contestants]
        return [self._made(self._encounter.forfeit(one, "killed", "", 0.0), one) for one in contestants]

    def image(self, contestant: int) -> Made:
        """Let a contestant of the scene that was observed last meet the observation."""
        assert self._scene is not None
        assert self._encounter is not None
        chosen = self._scene.contestants[contestant]
        return self._made(self._encounter.meet(chosen), chosen)

    def work(self, block: Block) -> Iterator[Made]:
        """Work off a block, without any guard."""
        self.observe(block)
        for contestant in block.contestants:
            yield self.image(contestant)

    def environment(self, contestant: Contestant[Any]) -> tuple[str, Environment]:
        """Name and description of the environment in which a contestant runs here."""
        key = contestant.name, contestant.params
        if key not in self._environments:
            environment = environment_of(contestant.plugin)
            self._environments[key] = environment_id(environment), environment
        return self._environments[key]

    def _made(self, outcome: Outcome, contestant: Contestant[Any]) -> Made:
        name, environment = self.environment(contestant)
        return Made(outcome.made_by(name), environment)
