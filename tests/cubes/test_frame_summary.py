"""Summaries of recorded frames: strongest cell, and the convention in which echoes come from the region."""

from dataclasses import replace

import numpy as np
import pytest

from isacbench.cubes.frame import CHANGES, observe_cube, summarise_frame
from isacbench.cubes.writing import FrameSimulator
from isacbench.errors import InputError
from isacbench.model.array import VirtualArray
from isacbench.model.echo import Simulator
from isacbench.model.region import Region
from isacbench.model.scene import Scatterers

from .test_path_lengths import scenario_of

# A region on one side of the panel and below it: no convention but one puts the echoes there.
PLACES = np.array([[18.0, 20.0, -2.0], [25.0, 28.0, 1.0], [30.0, 15.0, -4.0]])
SCENARIO = replace(
    scenario_of(("-u", "-w")),
    array=VirtualArray((1, 1), (8, 8), 1, 1),
    region=Region((15.0, 35.0), (10.0, 30.0), (-6.0, 2.0), (2.0, 40.0)),
    scatterers=Scatterers(PLACES, np.array([7.3, 12.0, 30.0]), np.ones(3)),
)
FRAME = np.concatenate([*FrameSimulator(SCENARIO, 0.0).blocks()])
CONJUGATED, DESCENDING, BACKWARDS, EXCHANGED, U_REVERSED, W_REVERSED = CHANGES
MISTAKES = {
    (): lambda cube: cube,
    (CONJUGATED,): np.conj,
    (U_REVERSED,): lambda cube: cube[:, :, ::-1],
    (W_REVERSED,): lambda cube: cube[:, :, :, ::-1],
    (U_REVERSED, W_REVERSED): lambda cube: cube[:, :, ::-1, ::-1],
    (EXCHANGED,): lambda cube: cube.swapaxes(2, 3),
    (DESCENDING,): lambda cube: cube[::-1],
    (BACKWARDS,): lambda cube: cube[:, ::-1],
    (BACKWARDS, W_REVERSED): lambda cube: cube[:, ::-1, :, ::-1],
    (CONJUGATED, U_REVERSED): lambda cube: cube[:, :, ::-1].conj(),
    (CONJUGATED, U_REVERSED, W_REVERSED): lambda cube: cube[:, :, ::-1, ::-1].conj(),
}


def frame_of(scenario):
    return np.concatenate([*FrameSimulator(scenario, 20.0).blocks()])


def summary_of(cube, scenario=SCENARIO):
    return summarise_frame(observe_cube(cube, scenario))


@pytest.mark.parametrize("changes", MISTAKES, ids=lambda changes: " and ".join(changes) or "right")
def test_the_convention_of_a_frame_is_told(changes):
    summary = summary_of(MISTAKES[changes](FRAME))
    assert summary.changes == changes
    if changes:
        assert summary.changed_share > summary.share + 0.3
        assert f"with {' and '.join(changes)}, " in summary.sentences()[1]
    else:
        assert summary.share > 0.9
        assert len(summary.sentences()) == 1


@pytest.mark.parametrize("scale", [1e-200, 1e-160, 1e200])
def test_the_unit_of_a_frame_does_not_matter(scale):
    assert summary_of(FRAME * scale).sentences() == summary_of(FRAME).sentences()


def test_exchanged_in_phase_and_quadrature_samples_are_conjugated_ones():
    assert summary_of(FRAME.imag + 1j * FRAME.real).changes == (CONJUGATED,)


def test_the_strongest_cell_is_that_of_the_strongest_echo_wherever_it_lies():
    alone = replace(SCENARIO, scatterers=Scatterers(PLACES[:1], np.array([7.3]), np.ones(1)))
    frame = frame_of(alone)
    summary = summary_of(frame)
    assert summary.range_m == pytest.approx(alone.range_m[0], abs=alone.system.range_bin_m / 2)
    assert summary.velocity_mps == pytest.approx(7.3, abs=alone.system.velocity_bin_mps / 2)
    assert summary.is_in_gate
    assert 0 < summary.n_detected < summary.n_cells
    receding = summary_of(frame.conj())
    assert receding.velocity_mps == pytest.approx(-7.3, abs=alone.system.velocity_bin_mps / 2)
    assert not receding.is_in_gate


def test_the_prs_alone_says_what_all_resource_elements_say():
    summary = summarise_frame(observe_cube(FRAME, SCENARIO, sensing="prs"))
    assert summary.is_in_gate
    assert summary.share > 0.9
    assert summary.changes == ()


@pytest.mark.parametrize("place", [(0.0, 54.0, 9.0), (1.5, 53.2, 8.3), (-2.0, 55.0, 10.0)])
def test_a_region_within_a_range_bin_is_not_doubted(place):
    near = replace(
        SCENARIO,
        system=replace(SCENARIO.system, n_subcarriers=64, n_symbols=16),
        region=Region((-2.0, 2.0), (53.0, 55.0), (8.0, 10.0), (-10.0, 10.0)),
        scatterers=Scatterers(np.array([place]), np.zeros(1), np.ones(1)),
    )
    assert len(summary_of(frame_of(near), near).sentences()) == 1


def test_a_scenario_of_another_spacing_is_doubted():
    system = replace(SCENARIO.system, subcarrier_spacing_hz=480e3)
    summary = summary_of(FRAME, replace(SCENARIO, system=system))
    assert (summary.is_in_gate, summary.changes) == (False, ())
    assert summary.sentences()[1].endswith("look at the scenario's radio, place and region")


@pytest.mark.parametrize("shape", [(2, 2), (3, 2), (8, 8)])
@pytest.mark.parametrize("seed", range(3))
def test_noise_alone_names_no_convention(seed, shape):
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((2, *FRAME.shape[:2], *shape))
    summary = summary_of(noise[0] + 1j * noise[1], replace(SCENARIO, array=VirtualArray((1, 1), shape, 1, 1)))
    assert (summary.n_echoes, summary.share, summary.changes) == (0, 0.0, ())
    assert summary.sentences()[0].endswith("; no echo stands out of the noise")


def test_a_frame_of_few_elements_and_one_of_zeros_are_summarised(monkeypatch):
    monkeypatch.setattr("isacbench.cubes.frame.MOST_VALUES", 1)
    assert summary_of(FRAME).n_detected > 0
    assert summary_of(np.zeros_like(FRAME)).n_detected == 0
    with pytest.raises(InputError, match="of a recorded frame"):
        summarise_frame(Simulator(SCENARIO).observe(0.0))


def test_a_map_smaller_than_a_window_is_summarised_without_detected_cells():
    system = replace(SCENARIO.system, n_subcarriers=8)
    summary = summary_of(FRAME[:8], replace(SCENARIO, system=system))
    assert summary.n_detected is None
    assert "cells, too few for a detector; " in summary.sentences()[0]
