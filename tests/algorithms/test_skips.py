"""What is left out changes nothing: angles of detected cells alone, tests of listed cells alone."""

from itertools import cycle, product

import numpy as np
import pytest
from isacbench_algorithms.chain import CellSnapshots, Levels
from isacbench_algorithms.detectors import CaCfar, GocaCfar, OscaCfar, OsCfar, SocaCfar, TmCfar

from isacbench.dsp.cell_detection import detect_cells, power_map
from isacbench.dsp.rangedoppler import GatedMap
from isacbench.model.echo import observe_echo
from tests.algorithms.scenes import EACH_CELLWISE, crowd
from tests.conftest import slow_but
from tests.dsp.plane_wave_data import pairs_of

# The factor of a trimmed mean of many looks takes long: it is tested with one element.
DETECTORS = [CaCfar(), OsCfar(), OscaCfar(), TmCfar(), GocaCfar(), OscaCfar(guard=1), SocaCfar()]
INTEGRATIONS = ["noncoherent", "element", "beams"]
DYNAMIC_RANGE_DB = 28.0


@EACH_CELLWISE
def test_angles_of_detected_cells_are_those_of_all_cells_selected(estimator):
    observation, method = observe_echo(crowd(30), 10.0), estimator()
    gated = GatedMap(observation.cells, observation.gate)
    detector = method.cell_detector()
    detected = detect_cells(gated.tapered("hann", "hann"), detector, "noncoherent", DYNAMIC_RANGE_DB)
    levels = Levels(detected.floor, detected.floor, 0.0)
    # The first rule takes single cells.
    rule = method.snapshot_rules()[0]
    tapered = gated.tapered(rule.range_window, rule.doppler_window)

    def waves_of(snapshots):
        return method.plane_waves(observation, CellSnapshots(rule, None, None, snapshots[:, None], levels))

    rows, columns = tapered.gate.index(detected.bins)
    alone = waves_of(tapered.cells[rows, columns])
    everywhere = waves_of(tapered.cells.reshape(-1, 8, 8)).select(rows * tapered.gate.shape[1] + columns)
    assert 10 < rows.size < 0.5 * gated.gate.range_bins.size * gated.gate.doppler_bins.size
    assert alone.found.any(axis=1).mean() > 0.3
    for cell in range(rows.size):
        one, other = (pairs_of(waves.select([cell])) for waves in (alone, everywhere))
        np.testing.assert_allclose(one, other, atol=1e-8)


@pytest.fixture(scope="module")
def tapered_street(small_street):
    """Return the tapered map of a street."""
    observation = observe_echo(small_street, 10.0)
    return GatedMap(observation.cells, observation.gate).tapered("hann", "hann")


@pytest.mark.parametrize(
    ("detector", "integration"),
    slow_but([*zip(DETECTORS, cycle(INTEGRATIONS), strict=False)], product(DETECTORS, INTEGRATIONS)),
)
def test_cells_listed_for_detection_are_those_of_the_whole_map(tapered_street, detector, integration):
    gated = tapered_street
    found = detect_cells(gated, detector, integration, DYNAMIC_RANGE_DB)
    power, looks = power_map(gated.cells, integration)
    if integration == "beams":
        mask = found.detection.mask & gated.gate.reachable
    else:
        mask = detector.detect(power, looks).mask & gated.gate.reachable & (power > found.floor)
    rows, columns = np.nonzero(mask)
    assert rows.size > 3
    assert np.array_equal(found.bins[0], gated.gate.range_bins[rows])
    assert np.array_equal(found.bins[1], gated.gate.doppler_bins[columns])
