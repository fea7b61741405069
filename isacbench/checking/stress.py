"""Stress: estimators and detectors go through cases, each in a guarded process, whatever becomes of it."""

from __future__ import annotations

import json
import math
import platform
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence, Set
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from itertools import product
from pathlib import Path
from queue import SimpleQueue
from typing import Any, NamedTuple

import pandas as pd

import isacbench
from isacbench.bench.cells.cell import seed_global_generators
from isacbench.bench.cells.process import GuardedProcess, ProcessLostError
from isacbench.bench.cells.provenance import git_state, machine, package_versions
from isacbench.bench.store.run_folder import atomic_write, open_folder
from isacbench.checking import cases
from isacbench.checking.checks import Case, Check, Choice, Family, Finding, Status, Subject, Whole, run_check
from isacbench.cores import one_blas_thread
from isacbench.errors import InputError, unknown_name
from isacbench.plugins.discovery import PluginFile, PluginKind, local_plugins, register_plugin
from isacbench.plugins.registry import build_variants, canonical_params
from isacbench.process_state import process_state_kept
from isacbench.specifications import parse_spec

TIMEOUT_S = 120.0
"""Longest time of a case in s; most take milliseconds, thousands of scatterers seconds."""

BROKEN: frozenset[Status] = frozenset({"failed", "timeout", "killed"})
"""Ends of a case that are to be reported."""

KEY = ["kind", "case", "estimator", "params", "seed"]
CASE_COLUMNS = [*KEY, "outcome", "promise", "drift", "bound", "time_s", "message", "reproduce"]
CHECK_COLUMNS = [*KEY, "promise", "outcome", "drift", "bound", "time_s", "message"]

FILES = TABLE, PROMISES, ABOUT = "stress.csv", "promises.csv", "stress.json"

FAMILIES: dict[str, Family] = {
    family.name: family for family in vars(cases).values() if isinstance(family, Family)
}
"""Families by name: all that the module of cases defines, in the order of the table."""


def find_cases(text: str, kinds: Set[PluginKind] = frozenset()) -> list[Case]:
    """Cases of a specification: all of a family's table, or one, ``name[param=value,...]``.

    Those of other kinds of plugins than are given are refused.

    Examples
    --------
    >>> [case.spec for case in find_cases("frame")]
    ['frame[frame=paper]', 'frame[frame=turned_panel]']
    >>> find_cases("snr[snr_db=33]")[0].spec
    'snr[snr_db=33]'
    """
    spec = parse_spec(text)
    if spec.name not in FAMILIES:
        raise unknown_name("family of cases", spec.name, FAMILIES)
    family = FAMILIES[spec.name]
    if kinds and family.kind not in kinds:
        raise InputError(
            f"case {text!r} is a case for {family.kind}s, but only {' and '.join(kinds)}s were selected"
        )
    return [family.case(**spec.params)] if "[" in text else family.cases()


def find_families(names: Sequence[str], kinds: Set[PluginKind]) -> list[Family]:
    """Families by name, all of those kinds of plugins without a name; refuse cases, and other kinds."""
    for name in names:
        if "[" in name:
            raise InputError(f"case {name!r}: a search draws from families; give {name.partition('[')[0]}")
        find_cases(name, kinds)
    return [
        family for family in FAMILIES.values() if family.kind in kinds and (family.name in names or not names)
    ]


class Target(NamedTuple):
    """An estimator or a detector under stress: its kind, specification, and all parameters as JSON."""

    kind: PluginKind
    spec: str
    params: str


class Task(NamedTuple):
    """A case that a target is to go through; the seed is that of what is random in the case."""

    target: Target
    case: Case
    seed: int


class CaseResult(NamedTuple):
    """A task and its findings: one a check."""

    task: Task
    findings: list[Finding]

    @property
    def worst(self) -> Finding:
        """Finding that counts: one that is broken, else the one that came closest to its bound."""
        return max(self.findings, key=_severity)

    @property
    def is_broken(self) -> bool:
        """True if a check has failed, or the process was lost."""
        return self.worst.status in BROKEN

    @property
    def status(self) -> Status:
        """How the whole case ended."""
        return self.worst.status if self.is_broken else self.findings[0].status

    @property
    def time_s(self) -> float:
        """Time of all checks together."""
        return sum(finding.time_s for finding in self.findings)

    @property
    def reproduce(self) -> str:
        """Command that runs this case alone."""
        target, case, seed = self.task
        plugins = [part for file in local_plugins() if file.path for part in ("--plugin", file.path)]
        option = "-e" if target.kind == "estimator" else "-d"
        return shlex.join(
            ["isacbench", "stress", *plugins, option, target.spec, "--case", case.spec, "--seed", str(seed)]
        )


def _severity(finding: Finding) -> tuple[bool, float]:
    """Key that sorts what is broken last, then by the share of its bound that a difference takes."""
    difference, bound = finding.difference, finding.bound
    share = difference / bound if bound else math.inf if difference else 0.0
    return finding.status in BROKEN, -1.0 if math.isnan(share) else share


def find_targets(kind: PluginKind, specs: Sequence[str]) -> list[Target]:
    """Targets that specifications stand for, grids included, each once."""
    variants = (variant for text in specs for variant in build_variants(kind, text))
    return list(dict.fromkeys(Target(kind, spec, canonical_params(plugin)) for spec, plugin in variants))


def tasks_of(targets: Sequence[Target], cases: Sequence[str], seed: int) -> list[Task]:
    """Every target through every case that is meant for it: of families or cases, without any of all tables.

    Refuses a case that is unknown, or meant for none of the targets.
    """
    kinds = {target.kind for target in targets}
    texts = dict.fromkeys(cases or [family.name for family in find_families([], kinds)])
    pairs = product(targets, [case for text in texts for case in find_cases(text, kinds)])
    return [Task(target, case, seed) for target, case in pairs if case.family.kind == target.kind]


def run_case(case: Case, plugin: Any, seed: int = 0) -> list[Finding]:
    """Put a plugin through a case: a finding a check, the first alone unless it passes.

    There is one of the "input" alone where plugin and case do not come together.
    """
    made: list[Any] = []
    put_together = Check("input", lambda one: made.extend(case.make(one.plugin, seed)))
    finding = run_check(put_together, Subject(plugin), is_strict=True)
    if not made:
        return [finding]
    subject, checks = made
    first, *others = (partial(run_check, check, subject, is_strict=True) for check in checks)
    finding = first()
    return [finding, *(run() for run in others)] if finding.status == "ok" else [finding]


class CaseProcess(GuardedProcess):
    """A guarded process that runs cases of at most that many seconds."""

    def __init__(self, timeout_s: float) -> None:
        super().__init__(_start, local_plugins())
        self._timeout_s = timeout_s
        self._target: Target | None = None

    def run(self, task: Task) -> CaseResult:
        """Put a target through a case; a plugin that hangs or dies has a finding, too."""
        target, case, seed = task
        if self._target not in (None, target):
            self.renew()  # whatever one plugin has done to its process, the next has another
        self._target = target
        try:
            findings = self.call(_run, target.kind, target.spec, case.spec, seed, timeout_s=self._timeout_s)
        except ProcessLostError as loss:
            time_s = self._timeout_s if loss.status == "timeout" else math.nan
            findings = [Finding("finite", loss.status, loss.reason, time_s=time_s)]
        return CaseResult(task, findings)


def run_cases(tasks: Sequence[Task], jobs: int = 1, timeout_s: float = TIMEOUT_S) -> Iterator[CaseResult]:
    """Run tasks in that many processes side by side; results come in the order of the tasks."""
    idle: SimpleQueue[CaseProcess] = SimpleQueue()
    with ExitStack() as stack:
        threads = stack.enter_context(ThreadPoolExecutor(jobs))
        for _ in range(jobs):
            idle.put(stack.enter_context(CaseProcess(timeout_s)))
        stack.callback(threads.shutdown, wait=False, cancel_futures=True)

        def run_one(task: Task) -> CaseResult:
            process = idle.get()
            try:
                return process.run(task)
            finally:
                idle.put(process)

        yield from threads.map(run_one, tasks)


def cases_from(family: Family) -> Any:
    """Make the strategy of hypothesis that draws from all cases of a family."""
    from hypothesis import strategies as st

    def values(space: Any) -> Any:
        if isinstance(space, Choice):
            return st.sampled_from(space.values)
        if isinstance(space, Whole):
            return st.integers(int(space.low), int(space.high))
        return st.floats(space.low, space.high, allow_subnormal=False)

    return st.builds(family.case, **{name: values(space) for name, space in family.spaces.items()})


class _FoundError(Exception):
    """A case is broken."""


def search(
    targets: Sequence[Target],
    families: Sequence[Family],
    n_examples: int,
    seed: int,
    timeout_s: float,
    progress: Callable[[Target, Family], None] = lambda target, family: None,
) -> Iterator[CaseResult]:
    """Draw that many cases for each target and family, and yield the simplest that is broken, if any is.

    The seed is that of the draws and of what is random in a case. `progress` is called with each target and
    family before they are searched.
    """
    import hypothesis

    settings = hypothesis.settings(
        max_examples=n_examples,
        deadline=None,
        database=None,
        phases=(hypothesis.Phase.generate, hypothesis.Phase.shrink),
        suppress_health_check=list(hypothesis.HealthCheck),
        report_multiple_bugs=False,
    )
    found: list[CaseResult] = []
    with CaseProcess(timeout_s) as process:
        for target, family in product(targets, families):
            if family.kind != target.kind:
                continue

            @hypothesis.seed(seed)
            @settings
            @hypothesis.given(cases_from(family))
            def attempt(case: Case) -> None:
                result = process.run(Task(target, case, seed))  # noqa: B023, called in this turn
                if result.is_broken:
                    found[:] = [result]  # the last one that is tried is the simplest
                    raise _FoundError

            progress(target, family)
            found.clear()
            with suppress(_FoundError):
                attempt()
            yield from found


def case_table(results: Sequence[CaseResult]) -> pd.DataFrame:
    """A row a case and target, with the check that is broken, or came closest to its bound."""
    rows = [
        _columns(result, result.worst)
        | {"outcome": result.status, "time_s": result.time_s, "reproduce": result.reproduce}
        for result in results
    ]
    return pd.DataFrame(rows, columns=CASE_COLUMNS)


def check_table(results: Sequence[CaseResult]) -> pd.DataFrame:
    """A row a check, case and target."""
    rows = [_columns(result, finding) for result in results for finding in result.findings]
    return pd.DataFrame(rows, columns=CHECK_COLUMNS)


def _columns(result: CaseResult, finding: Finding) -> dict[str, Any]:
    target, case, seed = result.task
    values = [
        *(
            target.kind,
            case.spec,
            parse_spec(target.spec).name,
            target.params,
            seed,
            finding.check,
            finding.status,
        ),
        *(finding.difference, finding.bound, finding.time_s, finding.message),
    ]
    return dict(zip(CHECK_COLUMNS, values, strict=True))


@contextmanager
def stress_folder(folder: Path, results: Sequence[CaseResult], timeout_s: float) -> Iterator[None]:
    """Create the folder of a stress run, or enter one to replace its tables, and keep others out.

    Whatever ends the block, the results so far are written, and what made them.
    """
    with open_folder(folder, {*FILES}, "a stress run"):
        try:
            yield
        finally:
            about = {
                "isacbench": isacbench.__version__,
                "git": git_state(),
                "python": platform.python_version(),
                "packages": package_versions(),
                "machine": machine(),
                "argv": sys.argv,
                "seeds": sorted({result.task.seed for result in results}),
                "timeout_s": timeout_s,
                "n_cases": len(results),
                "n_findings": sum(result.is_broken for result in results),
            }
            tables = (table(results).to_csv(index=False) for table in (case_table, check_table))
            texts = *tables, json.dumps(about, indent=2, ensure_ascii=False) + "\n"
            for name, text in zip(FILES, texts, strict=True):
                with atomic_write(folder / name) as path:
                    path.write_text(text, encoding="utf-8")


# What follows runs in the process.


def _start(plugins: tuple[PluginFile, ...]) -> None:
    for plugin in plugins:
        register_plugin(plugin)


def _run(kind: PluginKind, spec: str, case_spec: str, seed: int) -> list[Finding]:
    [(_, plugin)] = build_variants(kind, spec)
    [case] = find_cases(case_spec)
    with process_state_kept(), one_blas_thread():
        seed_global_generators(seed, spec, case_spec)
        return run_case(case, plugin, seed)
