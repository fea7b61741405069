"""What it costs to find the cells that hold an echo: tapers, power, noise, detectors."""

import numpy as np
import pytest
from isacbench_algorithms.detectors import CaCfar, GocaCfar, OscaCfar, OsCfar, SocaCfar, TmCfar

from isacbench.dsp.cell_detection import detect_cells, power_map, white_noise
from isacbench.dsp.cfar.factors import tm_factor

DETECTORS = pytest.mark.parametrize(
    "detector",
    [CaCfar(), OsCfar(), OscaCfar(), GocaCfar(), SocaCfar(), TmCfar()],
    ids=lambda detector: detector.name,
)


@pytest.mark.parametrize("window", ["soft", "hann", "blackman"])
def test_taper(benchmark, scene, window):
    assert benchmark(scene.gated.tapered, window, window).cells.shape[2:] == scene.scenario.array.shape


@pytest.mark.parametrize("integration", ["element", "noncoherent"])
def test_power_map(benchmark, scene, integration):
    assert (benchmark(power_map, scene.seen.cells, integration)[0] > 0).all()


def test_white_noise(benchmark, scene):
    assert benchmark(white_noise, scene.gated) > 0


@DETECTORS
def test_detect_cells(benchmark, scene, detector):
    assert benchmark(detect_cells, scene.seen, detector, "noncoherent", 28.0).bins[0].size


@DETECTORS
@pytest.mark.parametrize("n_cells", [100, 1000, 10_000, None])
def test_detect_on_a_whole_map(benchmark, noise_map, detector, n_cells):
    cells = None
    if n_cells is not None:
        rng = np.random.default_rng(1)
        cells = tuple(rng.integers(0, length, n_cells) for length in noise_map.shape)
    found = benchmark(lambda: detector.detect(noise_map, cells=cells).threshold)
    assert found.size == (n_cells or noise_map.size)


@pytest.mark.parametrize("looks", [2, 16, 256])
def test_factor_of_a_trimmed_mean(benchmark, looks):
    assert benchmark(tm_factor.__wrapped__, 1e-3, 72, (18, 18), looks) > 1
