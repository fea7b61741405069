import json

import pytest

from isacbench.errors import InputError
from isacbench.plugins.contracts import Detector
from isacbench.plugins.discovery import entries
from isacbench.plugins.registry import (
    build_estimator,
    build_variants,
    canonical_params,
    describe_plugin,
    detector_names,
    estimator_names,
    get_detector,
    get_estimator,
    sees_truth,
)

MINIMAL = """
from dataclasses import dataclass
from typing import ClassVar

@dataclass(frozen=True)
class Good:
    name: ClassVar[str] = "good"
    size: int
    def estimate(self, observation): ...

@dataclass
class Mutable:
    name: ClassVar[str] = "mutable"
    def estimate(self, observation): ...

@dataclass(frozen=True)
class Idle:
    name: ClassVar[str] = "idle"

def function(): ...
"""


def test_names_of_installed_plugins_are_listed_in_order(plugins):
    names = estimator_names()
    assert {"blob", "seer", "trouble"} <= set(names)
    assert names == sorted(names)
    assert "level" in detector_names()


def test_what_sees_the_truth_is_told_by_name(plugins):
    assert sees_truth("seer")
    assert not sees_truth("blob")
    with pytest.raises(InputError, match="unknown estimator 'seeer': did you mean 'seer'"):
        sees_truth("seeer")


def test_parameters_reach_the_estimator_and_the_rest_keep_their_defaults(plugins):
    estimator = get_estimator("blob", n=7, mode="far")
    assert (estimator.n, estimator.mode, estimator.pfa) == (7, "far", None)


def test_a_detector_parameter_takes_a_name_a_spec_or_a_detector(plugins):
    by_name = get_estimator("blob", detector="level")
    by_spec = build_estimator("blob[detector=level[pfa=0.25]]")
    by_object = get_estimator("blob", detector=get_detector("level", pfa=0.5))
    assert [e.detector.pfa for e in (by_name, by_spec, by_object)] == [1e-3, 0.25, 0.5]
    assert isinstance(by_spec.detector, Detector)


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("blop", "unknown estimator 'blop': did you mean 'blob'"),
        ("blob[mod=near]", "unknown parameter of estimator blob 'mod': did you mean 'mode'"),
        ("blob[mode=nearr]", "mode = 'nearr': should be 'near' or 'far'"),
        ("blob[n=[1,2]]", "names 2 variants ('blob[n=1]', ...); give one value"),
        ("blob[n=1.5]", "n = 1.5: should be a valid integer"),
        ("blob[n=true]", "n = True: should be a valid integer"),
        ("blob[pfa=x]", "pfa = 'x': should be a valid number"),
        ("blob[pfa=nan]", "pfa = nan: should be a finite number"),
        ("blob[cells=x]", "cells = 'x': should be a valid integer or a valid tuple"),
        ("blob[n=level[pfa=1]]", "n = level[...]: should be a valid integer"),
        ("blob[detector=levl]", "unknown detector 'levl': did you mean 'level'"),
        ("blob[detector=level[pfa=2]]", "detector level: pfa = 2.0: must lie between 0 and 1"),
        ("blob[detector=3]", "detector = 3: should be an instance of Detector"),
    ],
)
def test_a_wrong_name_or_value_is_answered_with_what_is_allowed(plugins, spec, message):
    with pytest.raises(InputError) as caught:
        build_estimator(spec)
    assert message in str(caught.value)


def test_every_variant_of_a_grid_is_built_and_its_text_builds_it_alone(plugins):
    built = build_variants("estimator", "blob[detector=[level,level[pfa=[0.25,0.5]]],n=[2,3]]")
    assert [(e.detector.pfa, e.n) for _, e in built] == [
        (1e-3, 2), (1e-3, 3), (0.25, 2), (0.25, 3), (0.5, 2), (0.5, 3)
    ]  # fmt: skip
    assert all(build_estimator(text) == estimator for text, estimator in built)


@pytest.mark.parametrize("get", [get_estimator, get_detector])
def test_a_name_with_parameters_is_refused_where_they_are_given_beside_it(plugins, get):
    with pytest.raises(InputError, match="give the name only"):
        get("level[pfa=0.5]")


def test_the_word_none_stands_for_no_value_only_where_a_field_takes_none(plugins):
    assert build_estimator("blob[pfa=none]").pfa is None
    assert build_estimator("trouble[kind=none]").kind == "none"


def test_canonical_parameters_are_complete_sorted_json_with_the_nested_detector_named(plugins):
    text = canonical_params(build_estimator("blob[n=2,detector=level[pfa=0.25],cells=(1,2)]"))
    assert json.loads(text) == {
        "cells": [1, 2],
        "detector": {"name": "level", "pfa": 0.25},
        "mode": "near",
        "n": 2,
        "pfa": None,
    }
    assert text == json.dumps(json.loads(text), sort_keys=True, separators=(",", ":"))


def test_canonical_parameters_do_not_depend_on_how_a_default_or_a_float_was_spelled(plugins):
    for one, other in (("blob", "blob[detector=level,n=4]"), ("blob[pfa=1]", "blob[pfa=1.0]")):
        assert canonical_params(build_estimator(one)) == canonical_params(build_estimator(other))


def test_descriptions_hold_one_line_the_types_the_defaults_and_the_package(plugins):
    blob = next(entry for entry in describe_plugin("estimator") if entry["name"] == "blob")
    assert blob["description"] == "Points around the middle of the region, spread by the noise."
    assert blob["parameters"]["n"] == {"type": "int", "default": 4}
    assert blob["parameters"]["detector"] == {
        "type": "Detector",
        "default": {"name": "level", "pfa": 0.001},
    }
    assert blob["package"] == entries("estimator")["blob"].origin == "test-plugins 1.0"


def test_two_packages_that_claim_one_name_are_both_named(plugins, plugin_folder):
    plugin_folder.install("rival-plugins", MINIMAL, estimators={"blob": "Good"})
    with pytest.raises(InputError, match=r"'blob' is registered twice") as caught:
        estimator_names()
    assert "test-plugins 1.0" in str(caught.value)
    assert "rival-plugins 1.0 (rival_plugins:Good)" in str(caught.value)


@pytest.mark.parametrize(
    ("name", "attribute", "message"),
    [
        ("other", "Good", "registered as 'other', but its class attribute name is 'good'"),
        ("mutable", "Mutable", "Mutable is no frozen dataclass"),
        ("function", "function", "function is no class"),
        ("idle", "Idle", "Idle has no method 'estimate'"),
        ("gone", "Gone", "cannot be loaded: AttributeError"),
        ("good", "Good", "missing parameter size"),
    ],
)
def test_a_plugin_that_breaks_the_contract_is_refused_by_name(plugin_folder, name, attribute, message):
    distribution_name = f"broken-{name}"
    plugin_folder.install(distribution_name, MINIMAL, estimators={name: attribute})
    with pytest.raises(InputError) as caught:
        get_estimator(name)
    assert message in str(caught.value)


def test_nothing_is_imported_until_a_plugin_is_asked_for(plugin_folder):
    plugin_folder.install("lazy-plugins", "raise RuntimeError('imported')", estimators={"lazy": "Lazy"})
    assert "lazy" in estimator_names()
    with pytest.raises(InputError, match="cannot be loaded: RuntimeError: imported"):
        get_estimator("lazy")
