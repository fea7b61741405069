"""Running stress cases: each in a guarded process, each with a row, whatever becomes of it."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from queue import SimpleQueue
from typing import Any, NamedTuple

from isacbench.bench.cells.isolation import seed_global_generators
from isacbench.bench.workers.guarded_process import GuardedProcess, ProcessLostError
from isacbench.checking.stress.case import Case
from isacbench.checking.stress.runs.examining import BROKEN, CaseOutcome, Verdict, examine
from isacbench.checking.stress.runs.families import find_cases, require_kind, table_of
from isacbench.cores import one_blas_thread
from isacbench.plugins.discovery import PluginFile, PluginKind, local_plugins, register_plugin
from isacbench.plugins.parameters import canonical_params
from isacbench.plugins.registry import build_variants
from isacbench.process_state import process_state_kept
from isacbench.specifications import parse_spec

TIMEOUT_S = 120.0
"""Longest time of a case in s; most take milliseconds, thousands of scatterers seconds."""


class Target(NamedTuple):
    """An estimator or a detector under stress.

    Attributes
    ----------
    kind : {"estimator", "detector", "metric"}
    spec : str
        ``name[param=value,...]``.
    params : str
        Canonical JSON of all parameters.
    """

    kind: PluginKind
    spec: str
    params: str

    @property
    def name(self) -> str:
        """Registered name."""
        return parse_spec(self.spec).name


class Task(NamedTuple):
    """A case that a target is to go through.

    Attributes
    ----------
    seed : int
        Seed of what is random in the case.
    options : tuple of str
        Further options of the command that runs it alone: where the plugin is found.
    """

    target: Target
    case: Case[Any]
    seed: int
    options: tuple[str, ...] = ()


class Examined(NamedTuple):
    """A task and its outcome: a verdict a promise."""

    task: Task
    verdicts: list[Verdict]

    @property
    def worst(self) -> Verdict:
        """Verdict that counts: a finding, else the one that came closest to its bound."""
        return max(self.verdicts, key=lambda verdict: verdict.severity)

    @property
    def outcome(self) -> CaseOutcome:
        """Outcome of the whole case."""
        return self.worst.outcome if self.is_broken else self.verdicts[0].outcome

    @property
    def is_broken(self) -> bool:
        """True for a finding."""
        return self.worst.outcome in BROKEN

    @property
    def time_s(self) -> float:
        """Time of all promises together."""
        return sum(verdict.time_s for verdict in self.verdicts)

    @property
    def reproduce(self) -> str:
        """Command that runs this case alone."""
        target, case, seed, options = self.task
        option = "-e" if target.kind == "estimator" else "-d"
        return shlex.join(
            ["isacbench", "stress", *options, option, target.spec, "--case", case.spec, "--seed", str(seed)]
        )


def find_targets(kind: PluginKind, specs: Sequence[str]) -> list[Target]:
    """Targets that specifications stand for, grids included.

    Parameters
    ----------
    kind : {"estimator", "detector", "metric"}

    Raises
    ------
    InputError
        If one cannot be built.
    """
    found = [
        Target(kind, spec, canonical_params(plugin))
        for text in specs
        for spec, plugin in build_variants(kind, text)
    ]
    return list(dict.fromkeys(found))


def tasks_of(
    targets: Sequence[Target], cases: Sequence[str], seed: int, options: tuple[str, ...] = ()
) -> list[Task]:
    """Every target through every case that is meant for it.

    Parameters
    ----------
    cases : sequence of str
        Families or cases; the whole fixed table where it is empty.
    options : tuple of str
        See `Task`.

    Raises
    ------
    InputError
        If a case cannot be found, or is meant for none of the targets.
    """
    kinds = {target.kind for target in targets}
    wanted = [] if cases else [case for kind in kinds for case in table_of(kind)]
    for text in dict.fromkeys(cases):
        members = find_cases(text)
        require_kind(text, type(members[0]), kinds)
        wanted += members
    return [
        Task(target, case, seed, options) for target in targets for case in wanted if case.kind == target.kind
    ]


class Examiner:
    """One guarded process that examines; to be closed.

    Parameters
    ----------
    timeout_s : float
        Longest time of a case in s.
    """

    def __init__(self, timeout_s: float = TIMEOUT_S) -> None:
        self._timeout_s = timeout_s
        self._target: Target | None = None
        self._process = GuardedProcess(_start, local_plugins())

    def close(self) -> None:
        """End the process."""
        self._process.stop()

    def examine(self, task: Task) -> Examined:
        """Put a target through a case.

        Returns
        -------
        Examined
            A plugin that hangs or dies has a verdict, too.
        """
        target, case, seed = task[:3]
        if self._target not in (None, target):
            self._process.renew()  # whatever one plugin has done to its process, the next has another
        self._target = target
        try:
            verdicts = self._process.call(
                _examine, target.kind, target.spec, case.spec, seed, timeout_s=self._timeout_s
            )
        except ProcessLostError as loss:
            time_s = self._timeout_s if loss.status == "timeout" else math.nan
            verdicts = [Verdict("finite", loss.status, time_s=time_s, message=loss.reason)]
        return Examined(task, verdicts)


def examine_all(tasks: Sequence[Task], jobs: int = 1, timeout_s: float = TIMEOUT_S) -> Iterator[Examined]:
    """Examine tasks in processes side by side.

    Parameters
    ----------
    jobs : int
        Number of processes.
    timeout_s : float
        Longest time of a case in s.

    Yields
    ------
    Examined
        In the order of the tasks.
    """
    idle: SimpleQueue[Examiner] = SimpleQueue()
    with ExitStack() as stack:
        threads = stack.enter_context(ThreadPoolExecutor(jobs))
        for _ in range(jobs):
            idle.put(stack.enter_context(closing(Examiner(timeout_s))))
        stack.callback(threads.shutdown, wait=False, cancel_futures=True)

        def examine_one(task: Task) -> Examined:
            examiner = idle.get()
            try:
                return examiner.examine(task)
            finally:
                idle.put(examiner)

        yield from threads.map(examine_one, tasks)


# What follows runs in the process.


def _start(plugins: tuple[PluginFile, ...]) -> None:
    for plugin in plugins:
        register_plugin(plugin)


def _examine(kind: PluginKind, spec: str, case_spec: str, seed: int) -> list[Verdict]:
    [(_, plugin)] = build_variants(kind, spec)
    [case] = find_cases(case_spec)
    with process_state_kept(), one_blas_thread():
        seed_global_generators(seed, spec, case_spec)
        return examine(case, plugin, seed)
