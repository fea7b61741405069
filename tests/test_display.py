"""Objects say what they are in a few lines, whatever state they are in."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

from isacbench.cubes.frame import CubeObservation
from isacbench.display import range_text, short_repr
from isacbench.model.cloud import PointCloud
from isacbench.model.echo import observe_echo
from isacbench.model.scenes.scenario import load_scenario
from isacbench.plugins.contracts import Detection, Diagnosis, Spectrum

NAN = np.full((3, 4), np.nan)
LONG_NAME = "\x1b[31m" * 40


@pytest.fixture(scope="module")
def street():
    return load_scenario("street")


@pytest.fixture(scope="module")
def seen(street):
    return observe_echo(street, snr_db=10)


@pytest.fixture(scope="module")
def extreme(street):
    """A scenario whose every number is long."""
    region = dataclasses.replace(
        street.region, x_m=(-12345.678, 23456.789), speed_mps=(-0.000123456, 123.4567)
    )
    system = dataclasses.replace(street.system, carrier_hz=1.23456789e-3, subcarrier_spacing_hz=1234.56789)
    scatterers = dataclasses.replace(street.scatterers, velocity=np.zeros(len(street.scatterers)))
    return dataclasses.replace(street, name=LONG_NAME, region=region, system=system, scatterers=scatterers)


def lines_of(shown):
    lines = repr(shown).split("\n")
    assert 1 <= len(lines) <= 3
    assert "  " not in repr(shown).replace("\n  ", "\n")
    return lines


def test_a_scenario_is_told_by_its_name_its_radio_and_its_region(street):
    assert repr(street) == (
        "Scenario 'street': 466 scatterers, 16 x 16 virtual elements\n"
        "  frame PanelFrame; carrier 70 GHz; bandwidth 491.5 MHz; bins 0.305 m x 1.84 m/s;\n"
        "  base station (14, 100, 20) m; region x 0 to 30, y 0 to 20, z 0 to 20 m, -15 to 15 m/s"
    )


def test_an_observation_is_told_by_its_cells_its_gate_and_its_region(seen):
    assert repr(seen) == (
        "Observation: 89 x 33 range-Doppler cells of 16 x 16 virtual elements\n"
        "  cells complex128, 12 MB; sensing all; range 78.07 to 104.9 m (bins 256 to 344);\n"
        "  velocity -29.37 to 29.37 m/s (bins -16 to 16); "
        "region x 0 to 30, y 0 to 20, z 0 to 20 m, -15 to 15 m/s"
    )


def test_a_cloud_is_told_by_its_points_and_what_they_span():
    cloud = PointCloud([[1, 2, 3], [4.5, 2, -3]], [10, -10], [0.25, 1])
    assert lines_of(cloud) == [
        "PointCloud: 2 points",
        "  x 1 to 4.5 m; y 2 m; z -3 to 3 m; velocity -10 to 10 m/s; power 0.25 to 1",
    ]
    assert repr(PointCloud.empty()) == "PointCloud: 0 points"


def test_a_detection_is_told_by_what_was_detected():
    mask = np.zeros((3, 4), dtype=bool)
    mask[0, 1] = True
    detection = Detection(mask, np.full((3, 4), 7.25), np.ones((3, 4)))
    assert lines_of(detection) == [
        "Detection: 1 of 12 cells detected (8.33 %)",
        "  map 3 x 4; threshold 7.25; noise 1",
    ]


@pytest.mark.parametrize(
    "detection",
    [
        Detection(NAN.astype(bool), NAN, NAN),
        Detection(np.empty((0, 0), dtype=bool), np.empty((0, 0)), np.empty((0, 0))),
        Detection([True, False], None, "none"),
        Detection(np.zeros(4, dtype=bool), np.ones(4), np.full(4, np.inf)),
    ],
)
def test_a_detection_that_is_none_is_shown_as_well(detection):
    assert lines_of(detection)[0].startswith("Detection: ")


def test_parts_of_a_scene_and_of_a_diagnosis_fit_on_a_few_lines(street, seen):
    power = np.ones(seen.gate.shape)
    detection = Detection(power > 2, power, power)
    spectrum = Spectrum(np.linspace(-1, 1, 500), np.zeros(500), None, np.empty(0), "u")
    diagnosis = Diagnosis(
        power, detection, seen.gate.range_bins, seen.gate.doppler_bins, (spectrum,) * 2, (300, 0)
    )
    for shown in (
        street.scatterers,
        seen.gate,
        seen.region,
        seen.system,
        seen.array,
        seen.frame,
        spectrum,
        diagnosis,
    ):
        lines_of(shown)
        assert len(repr(shown)) < 400
    assert repr(seen.gate).startswith("Gate: 89 range bins x 33 Doppler bins\n")


def test_long_numbers_and_names_do_not_take_more_lines(extreme):
    assert "\x1b" not in repr(extreme)
    lines_of(extreme)
    lines_of(observe_echo(extreme, snr_db=0))


def test_a_recorded_frame_is_told_without_being_read(street):
    observation = CubeObservation(object(), street, None, None, "all")
    assert "cells not read yet" in repr(observation)


def test_numbers_that_are_not_finite_are_counted_and_not_spanned():
    assert range_text([np.nan, 2.0, np.inf, 1.0], "m") == "1 to 2 m (2 not finite)"
    assert range_text(np.array([1j])) == "complex128 (1,)"


def test_arrays_tables_and_objects_in_a_dataclass_are_told_by_type_and_shape():
    cloud = PointCloud.empty()
    holder = Holder(np.zeros((2, 3)), pd.DataFrame({"a": [1]}), cloud, "x" * 1000)
    assert repr(holder).startswith(
        "Holder(array=float64 (2, 3), table=DataFrame (1, 1), cloud=PointCloud: 0 points"
    )
    assert len(repr(holder)) < 250


@dataclasses.dataclass
class Holder:
    array: np.ndarray
    table: pd.DataFrame
    cloud: PointCloud
    text: str

    __repr__ = short_repr


def test_a_cloud_without_velocities_says_so():
    cloud = PointCloud([[1, 2, 3], [4, 5, 6]])
    assert "velocity unknown" in repr(cloud)
    assert "velocity unknown" in repr(cloud.select([1]))
    assert list(cloud.to_dataframe()) == ["x", "y", "z", "power"]
    assert np.isnan(cloud.to_array()[:, 3]).all()
