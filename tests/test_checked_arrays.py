"""Arrays from outside: what NumPy cuts off in silence is honoured, or refused in one line, at every door."""

import re
from collections import namedtuple
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import scipy.sparse

from isacbench.checked_arrays import checked_array, named_columns
from isacbench.cubes.frame import observe_cube
from isacbench.cubes.opening import open_cube
from isacbench.dsp.angles.aperture import Plane
from isacbench.dsp.angles.beamformers import bartlett_spectrum, capon_spectrum
from isacbench.dsp.angles.line_subspaces import music_null_spectrum, real_steering, smoothed_covariance
from isacbench.dsp.angles.planar_spectra import squared_projections
from isacbench.dsp.angles.planar_subspaces import leading_eigenpairs, planar_covariance
from isacbench.dsp.angles.plane_waves import PlaneWaves
from isacbench.dsp.partial_dft import doppler_rows, range_rows
from isacbench.errors import InputError
from isacbench.link.waveform.ofdm import demodulate
from isacbench.link.waveform.qam import awgn_ber, modulate_bits
from isacbench.link.waveform.resource_grid import hard_decision_capacity
from isacbench.model.cloud import PointCloud
from isacbench.model.echo import Simulator
from isacbench.model.frame import get_frame
from isacbench.model.gate import Gate
from isacbench.model.kernels import dirichlet, steering
from isacbench.model.numerology import System
from isacbench.model.scene import Scatterers
from isacbench.plugins.registry import get_detector
from isacbench.plugins.scoring import score
from tests.algorithms.scenes import EMPTY, simulator
from tests.dsp.plane_wave_data import noise

ROW = [1.0, 2.0, 3.0, 4.0]
OBSERVATION = simulator().observe(20.0)
SHAPE = EMPTY.system.n_subcarriers, EMPTY.system.n_symbols, *EMPTY.array.shape
FRAME = np.ones(SHAPE, dtype=np.complex64)


def masked(values):
    """The values, the last of them masked."""
    array = np.ma.array(values)
    array[(-1,) * array.ndim] = np.ma.masked
    return array


DOORS = {
    "a cloud": lambda make: PointCloud.from_array(make(np.ones((2, 4)))),
    "velocities of a cloud": lambda make: PointCloud(np.ones((2, 3)), make(np.ones(2)), np.ones(2)),
    "a truth": lambda make: score(make(np.ones((2, 4))), [ROW]),
    "an estimate": lambda make: score([ROW], make(np.ones((2, 4)))),
    "scatterers": lambda make: Scatterers(make(np.ones((2, 3))), np.ones(2), np.ones(2)),
    "a map": lambda make: get_detector("ca", training=2, guard=1).detect(make(np.ones((20, 20)))),
    "places of detections": lambda make: OBSERVATION.cloud(make(np.ones(2)), *np.ones((4, 2))),
    "directions of detections": lambda make: OBSERVATION.cloud(
        *np.ones((2, 2)), make(np.ones(2)), *np.ones((2, 2))
    ),
    "powers of detections": lambda make: OBSERVATION.cloud(*np.ones((4, 2)), make(np.ones(2))),
    "a grid": lambda make: observe_cube(FRAME, EMPTY, make(np.ones(SHAPE[:2]))),
    "cells": lambda make: replace(OBSERVATION, cells=make(OBSERVATION.cells.real)),
    "snapshots of lines": lambda make: smoothed_covariance(make(np.ones((1, 4, 2))), 3),
    "snapshots of planes": lambda make: planar_covariance(make(np.ones((1, 1, 4, 4))), (3, 3)),
    "bins of a gate": lambda make: Gate(make(np.arange(3)), np.arange(3), slice(3), slice(3)),
    "bins of a transform": lambda make: range_rows(make(np.arange(3)), 8),
    "points of a region": lambda make: EMPTY.region.contains(make(np.ones((2, 3)))),
    "directions of a frame": lambda make: get_frame("panel").direction_cosines(make(np.ones((2, 3)))),
    "offsets of a frame": lambda make: get_frame("panel").offsets(*np.ones((2, 2)), make(np.ones(2))),
    "directions of steering vectors": lambda make: steering(4, make(np.ones(2))),
    "places of kernels": lambda make: dirichlet(np.ones(2), make(np.ones(2)), 4),
    "elements": lambda make: EMPTY.array.in_frame(make(np.ones((2, 2), int))),
    "bit error rates": lambda make: hard_decision_capacity(make(np.zeros(2))),
    "levels of noise": lambda make: awgn_ber("qpsk", make(np.zeros(2))),
    "a waveform": lambda make: demodulate(make(np.ones(9)), System()),
}


@pytest.mark.parametrize("door", DOORS)
def test_masked_numbers_and_texts_are_refused_at_every_door(door):
    with pytest.raises(InputError, match="1 masked number"):
        DOORS[door](masked)
    with pytest.raises(InputError, match=r"holds <U\d+; allowed are .*numbers"):
        DOORS[door](lambda values: values.astype(np.int64).astype(str))
    with pytest.raises(InputError, match=r"holds object; allowed are .*numbers"):
        DOORS[door](scipy.sparse.csr_array if door == "a grid" else lambda values: values.astype(object))


@pytest.mark.parametrize(
    "door", [name for name in DOORS if name[:5] in ("a clo", "veloc", "a tru", "a map", "place")]
)
def test_imaginary_parts_are_not_cut_off(door):
    with pytest.raises(InputError, match="holds complex128; allowed are real numbers"):
        DOORS[door](lambda values: values * 1j)


@pytest.mark.parametrize("door", ["bins of a gate", "bins of a transform"])
def test_fractions_of_bins_are_not_cut_off(door):
    with pytest.raises(InputError, match="holds float64; allowed are whole numbers"):
        DOORS[door](lambda values: values + 0.5)
    with pytest.raises(InputError, match="holds float64"):
        doppler_rows([0.5], 8)


def test_a_mask_that_hides_nothing_is_no_mask():
    cloud = PointCloud.from_array(np.ma.masked_equal([ROW], -9999))
    assert cloud.to_array().tolist() == [[*ROW, 1.0]]


class Convertible:
    """Numbers that NumPy is given when it asks, as by variables of NetCDF files."""

    def __init__(self, array):
        self.array = array

    def __array__(self, dtype=None, copy=None):
        return self.array


HIDING = {
    "rows": lambda rows: [np.ma.masked_equal(rows[0], 3.0), *rows[1:]],
    "numbers": lambda rows: [[np.ma.masked if x == 3.0 else x for x in row] for row in rows],
    "conversions": lambda rows: Convertible(np.ma.masked_equal(rows, 3.0)),
    "tuples": lambda rows: tuple((*row[:2], np.ma.masked, *row[3:]) if 3.0 in row else row for row in rows),
}


@pytest.mark.parametrize("kind", HIDING)
def test_masks_inside_lists_count(kind):
    rows = HIDING[kind]([[1.0, 2.0, 3.0], [1.0, 2.0, 4.0]])
    for values in (rows, *([] if kind == "conversions" else ([rows, rows], [[[rows]]]))):
        with pytest.raises(InputError, match="xyz has 1 masked number"):
            checked_array("xyz", values)


TABLE = pd.DataFrame([[4.0, 3.0, 2.0, 1.0]] * 2, columns=list("vzyx"))
ROWS_WITH_NAMES = {
    "itertuples": list(TABLE.itertuples(index=False)),
    "Series": [row for _, row in TABLE.iterrows()],
    "dicts": TABLE.to_dict("records"),
    "records": list(TABLE.to_records(index=False)),
    "frames": [TABLE],
}


@pytest.mark.parametrize("kind", ROWS_WITH_NAMES)
def test_rows_with_names_are_not_taken_by_their_place(kind):
    with pytest.raises(
        InputError, match=r"a point array (is a table|has rows) of named columns|takes columns x, y, z, v"
    ):
        PointCloud.from_array(ROWS_WITH_NAMES[kind])


@pytest.mark.parametrize("shape", [(3,), (2, 1), (2, 2, 3)])
def test_points_of_another_shape_lie_in_no_region(shape):
    with pytest.raises(InputError, match=r"shape of xyz = .*allowed is \(n, 3\)"):
        EMPTY.region.contains(np.ones(shape))


def test_a_named_tuple_of_columns_is_a_table():
    points = namedtuple("Points", "v z y x")([4.0], [3.0], [2.0], [1.0])
    assert PointCloud.from_array(points).to_array().tolist() == [[*ROW, 1.0]]


def test_the_index_of_a_series_numbers_its_rows():
    assert checked_array("velocity", TABLE["v"][::-1]).tolist() == [4.0, 4.0]
    assert checked_array("row", TABLE.iloc[0]).tolist() == ROW[::-1]
    assert checked_array("columns", [TABLE["v"][::-1], TABLE["x"]]).tolist() == [[4.0, 4.0], [1.0, 1.0]]
    assert checked_array("bins", [pd.Index([0.5, 1.5])]).tolist() == [[0.5, 1.5]]


def test_a_cube_with_masked_numbers_is_refused():
    with pytest.raises(InputError, match="array has 1 masked number"):
        open_cube(masked(FRAME))


def test_points_are_selected_by_what_is_not_masked():
    cloud = PointCloud.from_array([ROW] * 3)
    for keep in (np.ma.array([True] * 3, mask=[0, 1, 0]), np.ma.array([0, 1], mask=[0, 1])):
        with pytest.raises(InputError, match="keep has 1 masked number"):
            cloud.select(keep)
    with pytest.raises(InputError, match="keep holds float64; allowed are whole numbers"):
        cloud.select([1.0])
    assert [len(cloud.select(keep)) for keep in ([], [True, False, True], [2, 2, 0, 1])] == [0, 2, 4]


class Quantity(np.ndarray):
    unit = "km"


def test_a_unit_is_not_cut_off():
    with pytest.raises(InputError, match="a point array has a unit; allowed are plain numbers"):
        PointCloud.from_array(np.array([ROW]).view(Quantity))


TABLES = {
    "DataFrame": lambda columns: pd.DataFrame(columns),
    "mapping": dict,
    "structured array": lambda columns: np.rec.fromarrays(list(columns.values()), names=list(columns)),
    "Arrow": lambda columns: __import__("pyarrow").table(columns),
}


@pytest.mark.parametrize("kind", TABLES)
def test_columns_of_a_table_are_taken_by_their_names(kind):
    columns = {"v": [4.0, 8.0], "power": [5.0, 9.0], "x": [1.0, 5.0], "z": [3.0, 7.0], "y": [2.0, 6.0]}
    cloud = PointCloud.from_array(TABLES[kind](columns))
    assert cloud.to_array().tolist() == [[1, 2, 3, 4, 5], [5, 6, 7, 8, 9]]
    without = {
        "velocity" if name == "v" else name: values for name, values in columns.items() if name != "power"
    }
    assert PointCloud.from_array(TABLES[kind](without)).power.tolist() == [1, 1]
    assert score(cloud, TABLES[kind](columns))["deviation"] == 0


@pytest.mark.parametrize(
    "names",
    ["x y v", "x y power", "x y z rcs", "x y z v rcs", "x y z v power label", "x y z v velocity", "X y z v"],
)
def test_a_table_with_other_columns_is_refused(names):
    with pytest.raises(InputError, match=f"takes columns x, y, z, v .*, not {', '.join(names.split())}"):
        PointCloud.from_array(pd.DataFrame(np.ones((2, len(names.split()))), columns=names.split()))


def test_a_table_without_names_is_an_array():
    assert named_columns(pd.DataFrame([ROW])) is None
    assert PointCloud.from_array(pd.DataFrame([ROW])).velocity.tolist() == [4.0]


@pytest.mark.parametrize(
    ("x", "shapes"), [([1.0], "x (1,), y (2,)"), (np.ones((2, 2)), "x (2, 2), y (2,)"), (1.0, "x (), y (2,)")]
)
def test_columns_of_other_shapes_than_a_number_a_point_are_refused(x, shapes):
    with pytest.raises(InputError, match=f"one number a point, .* not shapes {re.escape(shapes)}"):
        PointCloud.from_array({"v": [1, 2], "x": x, "y": [1, 2], "z": [1, 2]})


def test_numbers_of_the_same_kind_are_taken_and_an_empty_list_is_no_numbers():
    assert checked_array("values", np.array([1, 2], np.uint8)).dtype == np.float64
    assert checked_array("values", np.array([1.5], np.longdouble)).dtype == np.float64
    assert checked_array("bins", [], np.int64).size == 0
    kept = np.ones(2, np.complex64)
    assert checked_array("values", kept, np.complex64) is kept
    with pytest.raises(InputError, match="holds bool"):
        checked_array("values", [True])


COSINES = np.linspace(-0.9, 0.9, 7)
WAVES = PlaneWaves(np.full((2, 1), 0.1), np.full((2, 1), 0.2), np.ones((2, 1), dtype=bool))


@pytest.mark.parametrize(
    "of",
    [
        lambda x: smoothed_covariance(x, 4),
        lambda x: planar_covariance(x[None], (4, 4)),
        lambda x: bartlett_spectrum(x, COSINES, COSINES).power,
        lambda x: capon_spectrum(x, (3, 3), 0.1, COSINES, COSINES).power,
        lambda x: WAVES.amplitudes(x[None], Plane(6, 6)),
        lambda x: WAVES.unexplained(x, Plane(6, 6)),
    ],
)
def test_real_and_whole_snapshots_are_those_of_their_complex_copies(of):
    whole = np.rint(5 * noise(2, 6, 6, seed=1).real).astype(np.int8)
    for given in (whole, whole.astype(np.float64)):
        np.testing.assert_allclose(of(given), of(given.astype(np.complex128)), rtol=1e-5, atol=1e-6)


def test_whole_numbers_in_place_of_real_ones_do_not_round_steering_vectors():
    basis = np.eye(4, dtype=np.int64)[None]
    steering = real_steering(4, [0.3])
    wanted = music_null_spectrum(basis.astype(float), np.array([1]), steering)
    np.testing.assert_allclose(music_null_spectrum(basis, np.array([1]), steering), wanted)
    columns = basis[:, :, :, None]
    np.testing.assert_allclose(
        squared_projections(columns, [0.3], [0.1]), squared_projections(columns.astype(float), [0.3], [0.1])
    )
    many = np.diag(np.arange(40, 0, -1))[None]
    wanted = leading_eigenpairs(many.astype(float), 3)[0]
    np.testing.assert_allclose(leading_eigenpairs(many, 3)[0], wanted)


def test_a_cell_that_is_real_is_imaged_as_its_complex_copy():
    quiet = Simulator(EMPTY).observe(20.0)
    image = replace(quiet, cells=quiet.cells.real)
    np.testing.assert_array_equal(image.cells, quiet.cells.real.astype(np.complex128))


def test_bits_that_are_masked_are_refused():
    with pytest.raises(InputError, match="bits has 1 masked"):
        modulate_bits(masked([1, 0]), "qpsk")
