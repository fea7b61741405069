"""Options of a run: where cells run and within which limits, which of them, and which stored ones again."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from isacbench.bench.cells.cell import DEFAULT_TIMEOUT_S, Limits
from isacbench.bench.run.plan import Shard
from isacbench.errors import InputError, unknown_name

Rerun = Literal["failed", "stale", "all"]

DEFAULT_REPEATS = 5
"""The median of five repeats ignores two disturbed ones."""


@dataclass(frozen=True)
class RunOptions:
    """Options of a run that do not change what its cells yield, as `isacbench.run` takes them.

    Attributes
    ----------
    limits : Limits
        Of each cell in a worker.
    part : Shard or None
        Parsed `shard`.

    Raises
    ------
    InputError
        If a value is not allowed.
    """

    jobs: int | None = None
    timeout_s: float | None = DEFAULT_TIMEOUT_S
    memory_mib: float | None = None
    dask: str | None = None
    shard: str | None = None
    rerun: Collection[str] = ()
    mix_versions: bool = False
    timing: bool = False
    repeats: int | None = None
    limits: Limits = field(init=False)
    part: Shard | None = field(init=False)

    def __post_init__(self) -> None:
        for name, value in (("jobs", self.jobs), ("repeats", self.repeats)):
            if value is not None and value < 1:
                raise InputError(f"{name} {value}: allowed is 1 or more")
        if self.jobs is not None and self.dask is not None:
            raise InputError("jobs and dask cannot be given together: give one")
        if self.repeats is not None and not self.timing:
            raise InputError(f"repeats = {self.repeats} needs timing; without it each cell is estimated once")
        if self.timing and (self.dask is not None or (self.jobs or 1) > 1):
            where = "dask" if self.dask else f"jobs {self.jobs}"
            raise InputError(
                f"timing needs one job on this machine, not {where}: cells that run at the same time slow "
                "each other down"
            )
        for name in self.rerun:
            if name not in get_args(Rerun):
                raise unknown_name("cells to rerun", name, get_args(Rerun))
        object.__setattr__(self, "limits", Limits(self.timeout_s, self.memory_mib))
        object.__setattr__(self, "part", None if self.shard is None else Shard.parse(self.shard))
        if not self.is_guarded and self.limits not in (Limits(), Limits(None)):
            raise InputError("timeout_s and memory_mib limit worker processes: give jobs or dask as well")

    @property
    def is_guarded(self) -> bool:
        """True if cells run in worker processes, with limits."""
        return self.jobs is not None or self.dask is not None

    @property
    def n_repeats(self) -> int | None:
        """Timed repeats of each estimate; None for a run that is not timed."""
        return (self.repeats or DEFAULT_REPEATS) if self.timing else None

    def describe(self) -> dict[str, Any]:
        """Describe the options in terms of JSON."""
        return {
            "jobs": self.jobs,
            "timeout_s": self.timeout_s if self.is_guarded else None,
            "memory_mib": self.memory_mib if self.is_guarded else None,
            "dask": self.dask,
            "shard": None if self.part is None else f"{self.part.k}/{self.part.n}",
            "timing": self.timing,
            "repeats": self.n_repeats,
        }
