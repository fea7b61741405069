"""`isacbench image` with a choice of what is sent and what is sensed with."""

import subprocess
import sys
from functools import partial

import numpy as np
import pytest

import isacbench
from isacbench.bench.cells.images import image_reference
from isacbench.model.cloud import PointCloud
from isacbench.model.echo import resource_grid
from isacbench.model.scenes.scenario import load_scenario


@pytest.fixture
def image(tiny, command_line):
    """Image the tiny scene in a folder of its own."""
    return partial(command_line, "image", "-s", "tiny.toml")


def test_the_image_is_that_of_the_observation_through_the_same_signal(image, tiny):
    options = {"sensing": "prs", "modulation": "64qam", "division": "wiener"}
    for given in ({"sensing": "prs"}, {"modulation": "64qam"}, options, {}):
        arguments = [part for name, value in given.items() for part in (f"--{name}", value)]
        result = image("-e", "music2d", "--snr", "15", "-o", "cloud.npy", *arguments)
        assert result.exit_code == 0, result.output
        observation = isacbench.observe(load_scenario(tiny), 15.0, **given)
        expected = isacbench.get_estimator("music2d").estimate(observation)
        assert PointCloud.read("cloud.npy").to_array() == pytest.approx(expected.to_array())
        assert ", ".join(["tiny", "music2d", "15 dB", *given.values()]) in result.output


def test_a_recorded_frame_is_sensed_with_its_prs(image, tiny):
    scenario = load_scenario(tiny)
    cube = resource_grid(scenario, scenario.array.positions)
    np.save("frame.npy", cube.reshape(*cube.shape[:2], *scenario.array.shape))
    result = image("--cube", "frame.npy", "--sensing", "prs", "-e", "music2d", "-o", "cloud.npy")
    assert result.exit_code == 0, result.output
    assert "frame.npy, tiny, music2d, prs" in result.output
    observation = isacbench.observe(scenario, float("inf"), sensing="prs")
    expected = isacbench.get_estimator("music2d").estimate(observation)
    assert PointCloud.read("cloud.npy").to_array() == pytest.approx(expected.to_array(), rel=1e-6)


@pytest.mark.parametrize("spec", ["oracle", "chance"])
def test_the_scores_of_a_reference_are_means_with_their_spreads(image, tiny, spec):
    result = image("-e", spec)
    assert result.exit_code == 0, result.output
    scenario = load_scenario(tiny)
    expected = image_reference(isacbench.get_estimator(spec), scenario)
    assert "scores: mean ± spread over its realisations" in result.output
    told = dict(line.split(maxsplit=1) for line in result.output.splitlines() if line.startswith("  "))
    assert told["deviation"] == f"{expected.scores['deviation']:.6g} ±{expected.spreads['deviation']:.3g}"
    assert told["n_true"] == str(len(scenario.truth))


def test_an_image_loads_no_package_that_it_does_not_use(tiny):
    code = (
        "import sys\n"
        "from typer.testing import CliRunner\n"
        "from isacbench.cli import app\n"
        f"assert not CliRunner().invoke(app, ['image', '-s', {str(tiny)!r}]).exit_code\n"
        "print(*sys.modules)"
    )
    finished = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    unused = {"matplotlib", "pandas", "pyarrow", "scipy.signal", "scipy.stats", "h5py", "zarr", "scipy.io"}
    assert not unused & {*finished.stdout.split()}
