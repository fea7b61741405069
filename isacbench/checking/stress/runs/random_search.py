"""Random search: hypothesis draws cases from the spaces of the table, and simplifies those that break."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from typing import Any

from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import seed as seeded
from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

from isacbench.checking.stress.case import Case
from isacbench.checking.stress.runs.stress_runs import Examined, Examiner, Target, Task
from isacbench.checking.stress.spaces import Choice, Real, Space, Whole


def _drawn(space: Space) -> SearchStrategy[Any]:
    """Strategy of all values of a space."""
    match space:
        case Whole(low, high):
            return st.integers(low, high)
        case Real(low, high):
            return st.floats(low, high, allow_subnormal=False)
        case Choice(values):
            return st.sampled_from(values)


def cases_from(family: type[Case[Any]]) -> SearchStrategy[Case[Any]]:
    """Strategy of all cases of a family, from the spaces of its fields."""
    return st.builds(family, **{name: _drawn(space) for name, space in family.spaces().items()})


class _FoundError(Exception):
    """A promise is broken."""


def search(
    targets: Sequence[Target],
    families: Sequence[type[Case[Any]]],
    n_examples: int,
    seed: int,
    timeout_s: float,
    options: tuple[str, ...] = (),
    progress: Callable[[Target, type[Case[Any]]], None] = lambda target, family: None,
) -> Iterator[Examined]:
    """Look for cases that break a promise.

    Parameters
    ----------
    n_examples : int
        Number of cases drawn for each target and family.
    seed : int
        Seed of the search, and of the random parts of cases.
    timeout_s : float
        Longest time of a case in s.
    options : tuple of str
        See `isacbench.checking.stress.runs.stress_runs.Task`.
    progress : callable
        Called with each target and family before they are searched.

    Yields
    ------
    Examined
        The simplest case found that breaks a promise, one for each target and
        family that has any.
    """
    with closing(Examiner(timeout_s)) as examiner:
        for target in targets:
            for family in families:
                if family.kind == target.kind:
                    progress(target, family)
                    yield from _simplest_broken(target, family, n_examples, seed, options, examiner)


def _simplest_broken(
    target: Target,
    family: type[Case[Any]],
    n_examples: int,
    seed: int,
    options: tuple[str, ...],
    examiner: Examiner,
) -> list[Examined]:
    """Simplest broken case of a family that can be found: the last one that hypothesis tries."""
    found: list[Examined] = []

    @seeded(seed)
    @settings(
        max_examples=n_examples,
        deadline=None,
        database=None,
        phases=(Phase.generate, Phase.shrink),
        suppress_health_check=list(HealthCheck),
        report_multiple_bugs=False,
    )
    @given(cases_from(family))
    def attempt(case: Case[Any]) -> None:
        examined = examiner.examine(Task(target, case, seed, options))
        if examined.is_broken:
            found[:] = [examined]
            raise _FoundError

    try:
        attempt()
    except _FoundError:
        return found
    return []
