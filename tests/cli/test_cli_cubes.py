"""Frames on the command line: written, imaged, and refused before any work starts."""

import re

import numpy as np
import pytest
from typer.testing import CliRunner

from isacbench.cli import app
from isacbench.model.cloud import PointCloud

SCENARIO = """
name = "corner"

[system]
n_subcarriers = 256
n_symbols = 56

[array]
frame = "panel"
tx_shape = [1, 1]
rx_shape = [6, 6]

[base_station]
position_m = [14.0, 100.0, 20.0]

[region]
x_m = [0.0, 30.0]
y_m = [0.0, 20.0]
z_m = [0.0, 20.0]
speed_mps = [-15.0, 15.0]

[[objects]]
kind = "points"
file = "points.csv"
"""


def run(*args):
    return CliRunner().invoke(app, [str(arg) for arg in args])


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    """Path of a scenario of three points on a small array."""
    folder = tmp_path_factory.mktemp("scenario")
    (folder / "points.csv").write_text("x,y,z,v\n4,3,1,10\n14,12,9,0\n25,18,2,-8\n")
    path = folder / "corner.toml"
    path.write_text(SCENARIO)
    return path


@pytest.fixture(scope="module")
def frame(scenario, tmp_path_factory):
    """Path of its frame at 0 dB."""
    path = tmp_path_factory.mktemp("frame") / "frame.npy"
    shown = run("simulate", "-s", scenario, "--snr", 0, "-o", path)
    assert shown.exit_code == 0, shown.stderr
    assert "256 x 56 x 6 x 6, complex64, 4 MB" in shown.stdout
    return path


def test_the_image_of_a_written_frame_is_that_of_the_simulation(scenario, frame, tmp_path):
    clouds = [tmp_path / "recorded.csv", tmp_path / "simulated.csv"]
    recorded = run("image", "--cube", frame, "-s", scenario, "-e", "music2d", "-o", clouds[0])
    simulated = run("image", "-s", scenario, "--snr", 0, "-e", "music2d", "-o", clouds[1])
    assert recorded.exit_code == simulated.exit_code == 0, recorded.stderr
    assert " ms, reading, imports and tables included" in recorded.stdout
    first, second = (PointCloud.read(path).to_array() for path in clouds)
    assert len(first) == 3
    np.testing.assert_allclose(first, second, rtol=1e-5, atol=1e-4)
    # The same scores, a line each, to four digits.
    scores = [re.findall(r"^  (\w+)\s+(\S+)$", shown.stdout, re.M) for shown in (recorded, simulated)]
    assert [name for name, _ in scores[0]] == [name for name, _ in scores[1]]
    values = [[float(value) for _, value in each] for each in scores]
    np.testing.assert_allclose(*values, rtol=1e-3, atol=1e-6)


def test_a_transmitted_grid_beside_the_cube_is_taken_into_account(scenario, frame, tmp_path):
    cube = np.load(frame)
    transmitted = np.exp(2j * np.pi * np.random.default_rng(1).random(cube.shape[:2]))
    np.save(tmp_path / "received.npy", (cube * transmitted[:, :, None, None]).astype(np.complex64))
    np.save(tmp_path / "transmitted.npy", transmitted)
    options = "--transmitted", tmp_path / "transmitted.npy"
    divided = run("image", "-s", scenario, "--cube", tmp_path / "received.npy", *options)
    as_it_is = run("image", "-s", scenario, "--cube", tmp_path / "received.npy")
    assert re.search(r"recall\s+1$", divided.stdout, re.M)
    assert re.search(r"recall\s+0", as_it_is.stdout, re.M)


def test_a_frame_whose_elements_count_the_other_way_says_so_on_the_command_line(scenario, frame, tmp_path):
    mirrored = tmp_path / "mirrored.npy"
    np.save(mirrored, np.load(frame)[:, :, ::-1])
    clouds = tmp_path / "usual.csv", tmp_path / "other.csv"
    assert run("image", "--cube", frame, "-s", scenario, "-o", clouds[0]).exit_code == 0
    shown = run("image", "--cube", mirrored, "-s", scenario, "--ascending", "+u,-w", "-o", clouds[1])
    assert shown.exit_code == 0, shown.stderr
    np.testing.assert_allclose(*(PointCloud.read(path).to_array() for path in clouds), rtol=1e-5, atol=1e-4)


def hold_to_one_line(shown, message):
    assert (shown.exit_code, shown.stdout) == (2, "")
    assert re.search(message, shown.stderr)
    assert shown.stderr.count("\n") == 1


def test_a_mistaken_cube_ends_in_one_line_and_exit_code_2(scenario, frame, tmp_path):
    cube, path = np.load(frame), tmp_path / "mistaken.npy"
    with_nan = cube.copy()
    with_nan[3, 2, 1, 0] = np.nan
    for mistaken, message in (
        (cube[:-1], "255"),
        (cube.real, "complex"),
        (cube[0], "four"),
        (with_nan, r"subcarrier 3, symbol 2, element \(1, 0\)"),
    ):
        np.save(path, mistaken)
        hold_to_one_line(run("image", "-s", scenario, "--cube", path), message)
    path.write_bytes(frame.read_bytes()[:-1000])
    hold_to_one_line(run("image", "-s", scenario, "--cube", path), "mistaken.npy")


def test_a_frame_and_an_image_may_be_free_of_noise(scenario, tmp_path):
    shown = run(
        "simulate", "-s", scenario, "--snr", "inf", "--precision", "double", "-o", tmp_path / "frame.npy"
    )
    assert shown.exit_code == 0, shown.stderr
    for source in (("--snr", "inf"), ("--cube", tmp_path / "frame.npy")):
        shown = run("image", "-s", scenario, "-e", "esprit2d", "-o", tmp_path / "cloud.csv", *source)
        assert shown.exit_code == 0, shown.stderr
        cloud = PointCloud.read(tmp_path / "cloud.csv")
        assert len(cloud) == 3
        np.testing.assert_allclose(np.sort(cloud.xyz[:, 0]), [4, 14, 25], atol=1e-6)
