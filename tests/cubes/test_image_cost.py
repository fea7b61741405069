"""The cost of an image: the counts that follow from the sizes, and what really happens."""

import dataclasses
import json

import numpy as np
import pytest
from isacbench_algorithms.capon2d import Capon2d
from isacbench_algorithms.esprit2d import Esprit2d
from isacbench_algorithms.fft4d import Fft4d
from isacbench_algorithms.music2d import Music2d
from isacbench_algorithms.nomp4d import Nomp4d
from isacbench_algorithms.references import Oracle
from typer.testing import CliRunner

from isacbench import observe_cube
from isacbench.cli import app
from isacbench.cubes import frame
from isacbench.cubes.image_cost import image_cost
from isacbench.model.scenes.scenario import load_scenario

FRAME = 2048 * 224
CELLS, BYTES, OPERATIONS = "cells", "bytes", "operations"
ESTIMATORS = [
    *(Music2d(), Music2d(integration="element"), Fft4d(), Fft4d(integration="element")),
    *(Esprit2d(), Capon2d(), Nomp4d(max_rounds=1), Oracle()),
]


@pytest.fixture(scope="module")
def street():
    return load_scenario("street")


def steps_of(cost):
    return {step["name"]: step for step in cost["steps"]}


def test_the_full_chain_is_four_transforms_of_the_whole_frame(street):
    steps = steps_of(image_cost(street, Music2d()))
    n_all = FRAME * 256
    assert steps["read"]["full"][BYTES] == n_all * 8
    assert steps["Doppler"]["full"][OPERATIONS] == n_all * round(5 * np.log2(224))
    assert steps["range"]["full"][OPERATIONS] == n_all * 55
    assert steps["angles"]["full"][CELLS] == FRAME * 48 * 48


def test_what_is_computed_is_the_gate_on_the_elements_that_are_read(street):
    steps = steps_of(image_cost(street, Music2d(integration="element")))
    names = ("read", "Doppler", "range", "detection")
    cells = [steps[name]["computed"][CELLS] for name in names]
    assert cells == [FRAME * 31, 2048 * 33 * 31, 89 * 33 * 31, 89 * 33]


def test_beams_take_more_than_the_mean_power_and_less_than_all_directions(street):
    beams, mean = (
        steps_of(image_cost(street, Capon2d(integration=one)))["detection"]
        for one in ("beams", "noncoherent")
    )
    assert beams["method"] == "48 beams of 256 elements"
    each_beam_from_all_elements = 89 * 33 * 48 * 256 * 8
    assert mean["computed"][OPERATIONS] < beams["computed"][OPERATIONS] < each_beam_from_all_elements


def test_the_oracle_takes_no_echo(street):
    total = image_cost(street, Oracle())["total"]
    assert {*total["computed"].values()} == {0}
    assert total["full"][OPERATIONS] > 1e10


def test_a_wider_region_takes_more_and_an_fft_in_the_end(street):
    wider = dataclasses.replace(street.region, y_m=(-40.0, 100.0))
    costs = [image_cost(one, Music2d()) for one in (street, dataclasses.replace(street, region=wider))]
    assert [cost["range_method"] for cost in costs] == ["partial", "fft"]
    assert costs[1]["total"]["computed"][CELLS] > costs[0]["total"]["computed"][CELLS]


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=lambda one: f"{one.name}-{one.needs.elements}")
def test_an_image_reads_as_many_elements_as_planned(small_street, noisy_cube, estimator, monkeypatch):
    read = set()
    transform = frame.gate_cells

    def spy(cube, elements, *rest):
        read.update(map(tuple, elements.tolist()))
        return transform(cube, elements, *rest)

    monkeypatch.setattr(frame, "gate_cells", spy)
    truth = (small_street.truth,) if getattr(estimator, "needs_truth", False) else ()
    estimator.estimate(observe_cube(noisy_cube, small_street), *truth)
    assert len(read) == image_cost(small_street, estimator)["elements"]["read"]


def test_the_command_prints_steps_and_json():
    shown = CliRunner().invoke(app, ["plan", "-e", "music2d"])
    assert shown.exit_code == 0
    for part in ("256 of 256", "89 of 2048", "33 of 224", "Doppler", "angles", "echo", "noise"):
        assert part in shown.stdout
    content = json.loads(CliRunner().invoke(app, ["plan", "-s", "street", "-e", "fft4d", "--json"]).stdout)
    assert content["range_bins"] == [256, 344]
    assert content["total"]["full"]["bytes"] > content["total"]["computed"]["bytes"]
