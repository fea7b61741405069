"""Fields that came later: at the value that stands for what was before, nothing is another's."""

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from isacbench.added_fields import added_field, identity_fields
from isacbench.bench.suites.scenario_digest import (
    describe_scenario,
    restore_scenario,
    scenario_digest,
    truth_table,
)
from isacbench.model.scenes.scenario import load_scenario
from isacbench.plugins.parameters import canonical_params


@dataclass(frozen=True)
class Before:
    name: ClassVar[str] = "inner"
    pfa: float = 1e-3
    n: int = 3

    def detect(self, power, looks=1): ...


@dataclass(frozen=True)
class Since(Before):
    polish: bool = added_field(True, before=False)
    limits: tuple[int, int] = added_field((1, 2), before=(1, 2))


@dataclass(frozen=True)
class Outer:
    name: ClassVar[str] = "outer"
    inner: object = Before()


def test_parameters_at_the_value_before_are_those_without_the_field():
    assert canonical_params(Since(polish=False)) == canonical_params(Before())
    assert canonical_params(Outer(Since(polish=False))) == canonical_params(Outer())


def test_any_other_value_counts_the_default_included():
    texts = {
        canonical_params(one)
        for one in (Before(), Since(), Since(polish=False, limits=(1, 3)), Since(n=4, polish=False))
    }
    assert len(texts) == 4
    assert canonical_params(Since()) == '{"n":3,"pfa":0.001,"polish":true}'


def test_values_are_told_apart_by_their_type_as_json_tells_them():
    @dataclass(frozen=True)
    class One:
        x: object = added_field(1, before=1)

    assert [identity_fields(One(x)) for x in (1, True, 1.0)] == [{}, {"x": True}, {"x": 1.0}]


def test_arrays_are_told_by_what_they_are():
    @dataclass(frozen=True, eq=False)
    class Points:
        phase: object = added_field(None, before=None)

    assert identity_fields(Points()) == {}
    assert identity_fields(Points(np.zeros(3))).keys() == {"phase"}


@pytest.mark.parametrize("radius_m", [1.0, 2.5])
def test_a_scenario_comes_back_from_its_description_with_its_radius(tiny, radius_m):
    scenario = dataclasses.replace(load_scenario(tiny), radius_m=radius_m)
    described = describe_scenario(scenario)
    assert ("radius_m" in described) == (radius_m != 1)
    again = restore_scenario("tiny", described, truth_table(scenario))
    assert again.radius_m == radius_m
    assert scenario_digest(again) == scenario_digest(scenario)
