"""The populations as their files spell them; no scene of them is made here."""

from collections import Counter

import pytest

from isacbench.bench.suites.suite_kinds import load_suite
from isacbench.model.scenes.scene_families import family_specs

COUNTS = {
    "town": 16,
    "facade": 16,
    "crowd": 12,
    "weak": 16,
    "street": 8,
    "sparse": 8,
    "traffic": 12,
    "crossing": 12,
}


def specs(name):
    return [one for text in load_suite(name).scenarios for one in family_specs(text)]


@pytest.mark.parametrize(
    ("name", "counts", "seeds", "errors"),
    [
        ("population", COUNTS, range(1400, 1500), (0.0, 0.0)),
        ("population-errors", COUNTS, range(1400, 1500), (0.5, 5.0)),
        ("population-quick", dict.fromkeys(COUNTS, 4), range(500, 532), (0.0, 0.0)),
    ],
)
def test_each_seed_of_a_block_occurs_once_and_each_condition_in_a_quarter_of_each_family(
    name, counts, seeds, errors
):
    found = specs(name)
    assert sorted(one.parameters.seed for one in found) == list(seeds)
    assert {(one.parameters.gain_error_db, one.parameters.phase_error_deg) for one in found} == {errors}
    conditions = Counter(
        (one.family.name, one.parameters.frame, one.parameters.coherent_phase) for one in found
    )
    assert conditions == {
        (family, frame, phases): n // 4
        for family, n in counts.items()
        for frame in ("panel", "paper")
        for phases in (False, True)
    }


def test_the_suites_of_one_version_meet_the_same_estimators():
    suites = [load_suite(f"population{suffix}") for suffix in ("", "-errors", "-quick")]
    assert len({suite.estimators for suite in suites}) == 1
    assert {suite.version for suite in suites} == {6}
    assert suites[0].snr_db == (-45, -35, 10)
