"""Contents of a file beside its cube are used, told or ignored, whatever the format: the grid above all."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
import zarr
from scipy.io import savemat

from isacbench import get_estimator, load_scenario, observe_cube
from isacbench.cubes import open_cube, read_grid
from isacbench.errors import InputWarning
from isacbench.model.echo import resource_grid

from ..hostile.faults import CELL, CUBE, QPSK, M, N
from .samples import SHAPE, assert_gives, h5, mat, mat73, npz, write_zarr, zarr_of

MINI = """name = "mini"
[system]
n_subcarriers = 128
n_symbols = 56
[array]
frame = "panel"
tx_shape = [1, 1]
rx_shape = [8, 8]
[base_station]
position_m = [0, 60, 10]
[region]
x_m = [-60, 60]
y_m = [0, 60]
z_m = [0, 20]
speed_mps = [-40, 40]
[[objects]]
kind = "point"
position_m = [3, 10, 5]
velocity_mps = 7.3
"""


def added_to_consolidated(path):
    write_zarr(path, zarr_format=2, cube=CUBE)
    zarr.consolidate_metadata(path)
    zarr.open_group(path, mode="a", use_consolidated=False).create_array("transmitted", data=QPSK)


@pytest.fixture
def path_of(tmp_path):
    def write(suffix_and_writer, name="frame"):
        suffix, writer = suffix_and_writer
        path = Path(tmp_path / f"{name}{suffix}")
        writer(path)
        return path

    return write


USED = {
    "capital": npz(cube=CUBE, Transmitted=QPSK),
    "spaces": npz(**{"Cube": CUBE, " Transmitted ": QPSK}),
    "capital, mat": mat(Cube=CUBE, TRANSMITTED=QPSK),
    "structure": mat(cube=CUBE, transmitted={"grid": QPSK}),
    "structure of both": mat(frame={"cube": CUBE, "transmitted": QPSK, "carrier_hz": 70e9}),
    "structure of both, 7.3": mat73(**{"frame/cube": CUBE, "frame/transmitted": QPSK}),
    "flattened": npz(**{"frame.cube": CUBE, "frame.transmitted": QPSK}),
    "groups": h5(**{"frame/cube": CUBE, "frame/transmitted": QPSK}),
    "group of the grid": h5(cube=CUBE, **{"transmitted/values": QPSK}),
    "zarr groups": zarr_of(**{"frame/cube": CUBE, "frame/transmitted": QPSK}),
    "zarr capital": zarr_of(cube=CUBE, Transmitted=QPSK),
    "zarr, consolidated before": (".zarr", added_to_consolidated),
}


@pytest.mark.parametrize("contents", USED.values(), ids=USED)
def test_the_grid_is_used_wherever_it_lies(path_of, contents):
    path = path_of(contents)
    with open_cube(path) as cube:
        assert_gives(cube, CUBE)
        assert np.array_equal(cube.transmitted, QPSK)
    assert np.array_equal(read_grid(path), QPSK)


OTHERS = {
    "second cube": (npz(cube=CUBE, raw=CUBE), r"raw \(complex128 of shape"),
    "flat cube": (npz(cube=CUBE, raw=CUBE.ravel()), r"raw \(complex128 of shape"),
    "second cube in a group": (h5(cube=CUBE, **{"old/raw": CUBE}), "old/raw"),
    "map beside the grid": (mat(cube=CUBE, transmitted=np.ones((N, M)), map=np.ones((N, M))), "map"),
    "calibration": (h5(cube=CUBE, calibration=np.ones(SHAPE[2:], complex)), r"calibration \(complex"),
    "a vector each symbol": (npz(cube=CUBE, x0=QPSK[:, 0], x1=QPSK[:, 1]), "x0 .*, x1"),
    "cell": (mat(cube=CUBE, symbols=CELL), r"symbols \(cell\)$"),
    "Python objects": (npz(cube=CUBE, meta=np.array({"transmitted": QPSK})), r"meta \(object"),
    "link": (h5(lambda file: file.update(grid=h5py.SoftLink("/x")), cube=CUBE), r"grid \(link\)"),
}


@pytest.mark.parametrize(("contents", "unused"), OTHERS.values(), ids=OTHERS)
def test_what_may_be_data_and_is_not_used_is_told(path_of, contents, unused):
    with (
        pytest.warns(InputWarning, match=f"frame.* does not use {unused}"),
        open_cube(path_of(contents)) as cube,
    ):
        assert_gives(cube, CUBE)


METADATA = {
    "carrier_hz": 70e9,
    "f": np.arange(float(N)),
    "t": np.arange(float(M)),
    "positions": np.ones((12, 3)),
    "element_gain_db": np.ones(SHAPE[2:]),
    "scale": 1 + 0j,
    "note": "by hand",
    "transmitted_power_dbm": 20.0,
    "transmitted_modulation": "QPSK",
}


@pytest.mark.parametrize("contents", [npz, mat, mat73, zarr_of, h5])
def test_scalars_texts_axes_and_other_shapes_beside_the_cube_are_no_grid(path_of, contents):
    held = {name: np.asarray(value) for name, value in METADATA.items()}
    if contents in (zarr_of, h5):
        held = {name: value for name, value in held.items() if value.dtype.kind != "U"}
    with open_cube(path_of(contents(cube=CUBE, **held))) as cube:
        assert_gives(cube, CUBE)
        assert cube.transmitted is None


@pytest.mark.parametrize("contents", [npz, mat, mat73, h5])
def test_the_axes_of_a_frame_of_one_symbol_are_no_grid(path_of, contents):
    path = path_of(contents(cube=CUBE[:, :1], f=np.arange(float(N)), t=0.5))
    with pytest.warns(InputWarning, match=r"does not use f \(float64"), open_cube(path) as cube:
        assert cube.transmitted is None


@pytest.mark.parametrize("contents", [npz, mat73, zarr_of, h5])
def test_a_grid_alone_may_have_settings_in_groups_beside_it(path_of, contents):
    path = path_of(contents(symbols=QPSK, **{"setup/limits": np.ones((2, 2))}))
    assert np.array_equal(read_grid(path), QPSK)


def test_a_frame_is_told_of_once(path_of, tmp_path):
    (tmp_path / "mini.toml").write_text(MINI)
    scenario = load_scenario(tmp_path / "mini.toml")
    frame = np.ones((128, 56, 8, 8), np.complex64)
    with pytest.warns(InputWarning) as told:
        _ = observe_cube(path_of(h5(cube=frame, raw=frame)), scenario).cross
    assert len(told) == 1


def test_the_image_of_a_received_frame_is_that_of_its_echoes(tmp_path):
    """(F X) / X = F: the one point, not one of eighteen."""
    (tmp_path / "mini.toml").write_text(MINI)
    scenario = load_scenario(tmp_path / "mini.toml")
    divided = resource_grid(scenario, scenario.array.positions).reshape(128, 56, 8, 8)
    grid = np.exp(0.5j * np.pi * np.random.default_rng(0).integers(4, size=divided.shape[:2]))
    received = divided * grid[:, :, None, None]
    savemat(tmp_path / "frame.mat", {"cube": received, "transmitted": {"grid": grid}})
    with h5py.File(tmp_path / "frame.h5", "w") as file:
        file["frame/cube"], file["frame/transmitted"] = received, grid
    for name in ("frame.mat", "frame.h5"):
        cloud = get_estimator("fft4d").estimate(observe_cube(tmp_path / name, scenario))
        assert np.allclose(cloud.xyz, [[3, 10, 5]], atol=0.1), name
