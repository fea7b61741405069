"""`music2d_joint` and `esprit2d`: plane waves of single cells, and the Cramér-Rao bound of a scatterer."""

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest
from isacbench_algorithms.chain import CellSnapshots, Levels
from isacbench_algorithms.esprit2d import Esprit2d
from isacbench_algorithms.music2d_joint import Music2dJoint

from isacbench.bench.cells.images import Image
from isacbench.bench.kinds.efficiency import BOUNDS, ERRORS
from isacbench.bench.kinds.efficiency import measure_efficiency as measure_error
from isacbench.model.array import VirtualArray
from isacbench.model.echo import Simulator
from isacbench.model.kernels import steering
from isacbench.model.radio_coordinates import DIMENSIONS, draw_place, gain_db, space_places
from isacbench.model.region import Region
from isacbench.model.scene import Scatterers
from isacbench.model.scenes.scenario import load_scenario
from tests.algorithms.scenes import NOTHING, simulator
from tests.conftest import slow_but
from tests.dsp.plane_wave_data import noise

BOTH = pytest.mark.parametrize("estimator", [Esprit2d, Music2dJoint])

RAYLEIGH = 2 / 16
RESOLVED, CROWD, SINGLE = Esprit2d().snapshot_rules()
# A cell is resolved only where it stands 18 dB above the noise of an element, 42 dB after 256 of them.
READINGS = pytest.mark.parametrize(("rule", "gain_db"), [(RESOLVED, 45.0), (CROWD, 40.0), (SINGLE, 40.0)])


@cache
def everywhere(n_p=16, n_q=16):
    """Observation of noise of unit power, of a region that spans every direction."""
    region = Region((-60.0, 90.0), (60.0, 99.0), (-55.0, 95.0), (-1.0, 1.0))
    empty = simulator(NOTHING, region=region, array=VirtualArray((1, 1), (n_p, n_q), 1, 1)).observe(0.0)
    scale = np.sqrt(np.mean(np.abs(empty.cells) ** 2))
    return replace(empty, cells=empty.cells / scale)


def waves_in(estimator, rule, snapshots, levels):
    """Waves found in snapshots (n, s, P, Q), as one rule takes them."""
    around = snapshots[:, [1, 0, 2]] if rule.range_cells == 3 else snapshots
    cells = CellSnapshots(rule, None, None, around, levels)
    return estimator.plane_waves(everywhere(*snapshots.shape[2:]), cells)


def plane_waves(estimator, u, w, phases=0.0, gain_db=45.0, n=1, shape=(16, 16), seed=0, rule=RESOLVED):
    """Waves found in n snapshots of equal ones: phases at the middle, gain after all elements."""
    n_p, n_q = shape
    u, w = np.array(u), np.array(w)
    amplitude = np.sqrt(10 ** (gain_db / 10) / (n_p * n_q))
    middle = np.pi * ((n_p - 1) / 2 * u + (n_q - 1) / 2 * w)
    gain = amplitude * np.exp(1j * (middle + np.broadcast_to(phases, u.shape)))
    clean = np.einsum("k,kp,kq->pq", gain, steering(n_p, u), steering(n_q, w))
    # Strongest cells 28 dB above the floor, as a detector has it.
    floor = max(1.0, np.mean(np.abs(clean) ** 2) * 10**-2.8)
    min_power = -np.log(estimator.angle_pfa) * floor / (n_p * n_q)
    snapshots = clean + noise(n, rule.range_cells, n_p, n_q, seed=seed)
    return waves_in(estimator, rule, snapshots, Levels(1.0, floor, min_power))


def misses(waves, u, w, tolerance):
    """How many cells do not show exactly the waves, each within a tolerance of its own."""
    missed = 0
    truth = np.stack([u, w], axis=1)
    for cell in range(len(waves.found)):
        found = np.stack([waves.u[cell], waves.w[cell]], axis=1)[waves.found[cell]]
        distance = np.linalg.norm(found[:, None] - truth, axis=2)
        right = len(found) == len(truth) and sorted(distance.argmin(axis=0)) == list(range(len(truth)))
        missed += not (right and distance.min(axis=0).max() < tolerance)
    return missed


@BOTH
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("phase_turns", [0, 0.125, 0.25, 0.5])
def test_a_quarter_of_a_rayleigh_cell_is_resolved_60_db_above_the_noise_in_phase_too(
    estimator, axis, phase_turns
):
    u, w = np.roll([[0.0, 0.25 * RAYLEIGH], [0.1, 0.1]], axis, axis=0)
    waves = plane_waves(estimator(), u, w, [0, 2 * np.pi * phase_turns], gain_db=60, n=20)
    assert misses(waves, u, w, 0.125 * RAYLEIGH) <= 2


@BOTH
@pytest.mark.parametrize("opposite", [False, True])
@pytest.mark.parametrize(
    ("u", "w"),
    [
        *(([0.2, 0.2], [-0.4, 0.1]), ([-0.4, 0.1], [0.2, 0.2]), ([0.95, -0.9], [0.1, 0.2])),
        *(([-0.3, 0.0, 0.3], [0.1, 0.1, 0.1]), ([-0.2, 0.0, 0.2], [-0.1, 0.0, 0.1])),
        ([-0.2, -0.2, 0.2, 0.2], [-0.3, 0.1, -0.3, 0.1]),
    ],
)
def test_coherent_sources_are_found_without_ghosts(estimator, u, w, opposite):
    phases = np.pi * opposite * np.arange(len(u))
    waves = plane_waves(estimator(), u, w, phases, gain_db=45, n=10)
    assert misses(waves, u, w, 0.02) == 0


@BOTH
@pytest.mark.parametrize("rule", [RESOLVED, CROWD, SINGLE])
@pytest.mark.parametrize("model_order", ["noise", "mdl", "aic"])
def test_every_order_finds_strong_separate_sources(estimator, model_order, rule):
    u, w = [-0.5, 0.0, 0.5], [0.3, -0.4, 0.1]
    waves = plane_waves(estimator(model_order=model_order), u, w, [0, 1, 2], n=10, rule=rule)
    assert misses(waves, u, w, 0.01) == 0


@BOTH
@READINGS
def test_the_eigenvalue_cfar_finds_the_strongest_of_them(estimator, rule, gain_db):
    method = estimator(model_order="eigenvalue_cfar")
    waves = plane_waves(method, [0.3], [-0.2], gain_db=gain_db, n=10, rule=rule)
    assert misses(waves, [0.3], [-0.2], 0.01) == 0


SMALL, ORDERS = [(2, 2), (3, 5), (2, 16), (8, 4)], ["noise", "eigenvalue_cfar", "mdl", "aic"]
OTHERS = ["mdl", "noise", "eigenvalue_cfar", "noise"]
QUICK = [*zip(SMALL * 2, ORDERS + OTHERS, strict=True)]


@BOTH
@pytest.mark.parametrize(("shape", "model_order"), slow_but(QUICK, product(SMALL, ORDERS)))
def test_small_arrays_serve_and_orders_stay_within_what_they_can_tell(estimator, shape, model_order):
    crowd, many = np.linspace(-0.5, 0.5, 7), estimator(model_order=model_order, max_sources=9)
    waves = plane_waves(many, crowd, crowd[::-1], gain_db=50, n=5, shape=shape)
    assert waves.found.shape[1] <= min(shape[0] * shape[1], 9)
    assert np.isfinite(waves.u[waves.found]).all()
    one = plane_waves(estimator(model_order=model_order), [0.1], [0.2], n=5, shape=shape)
    # A sixth of the beam.
    assert misses(one, [0.1], [0.2], 2 / min(shape) / 6) == 0


@BOTH
@pytest.mark.parametrize("polish", [0, 10])
def test_no_cells_and_one_cell(estimator, polish):
    method = estimator(polish=polish)
    for rule in method.snapshot_rules():
        none = np.empty((0, rule.range_cells, 16, 16), dtype=complex)
        assert len(waves_in(method, rule, none, Levels(1.0, 1.0, 0.1)).found) == 0
        waves = plane_waves(method, [0.3], [-0.2], rule=rule)
        assert misses(waves, [0.3], [-0.2], 0.01) == 0


@BOTH
def test_of_noise_nothing_is_left_that_its_power_does_not_explain(estimator):
    method = estimator()
    for rule in method.snapshot_rules():
        snapshots = noise(100, rule.range_cells, 16, 16)
        assert waves_in(method, rule, snapshots, Levels(1.0, 1.0, -np.log(1e-5) / 256)).found.sum() <= 3


def image(scenario, estimator, gained_db, trial):
    """Shot of a scenario at an SNR after all gains of one unit scatterer."""
    snr_db = gained_db - gain_db(scenario)
    observation = Simulator(scenario).observe(snr_db, trial)
    return Image(scenario, observation, estimator, snr_db, estimator.estimate(observation))


def one_scatterer(trial):
    """Scenario `single` with one unit scatterer at a place that knows no grid."""
    template = load_scenario("single")
    xyz, velocity = space_places(template, draw_place(template, trial, 0, 0.5)[None])
    return replace(template, scatterers=Scatterers(xyz, velocity, np.ones(1)))


def errors_over_bound(estimator, gained_db, trials):
    """Errors (trial, dimension) in standard deviations of the bound; each image must hold the one point."""
    rows = []
    for trial in trials:
        measured = measure_error(image(one_scatterer(trial), estimator, gained_db, trial))
        assert measured["hit"]
        assert not measured["n_false"]
        rows.append([measured[error] / measured[bound] for error, bound in zip(ERRORS, BOUNDS, strict=True)])
    return np.array(rows)


@pytest.mark.slow
@BOTH
@pytest.mark.parametrize("gained_db", [25.0, 35.0, 45.0, 60.0])
def test_directions_of_one_scatterer_err_by_less_than_1_3_of_the_cramer_rao_bound(estimator, gained_db):
    errors = errors_over_bound(estimator(), gained_db, range(60))
    ratio = dict(zip(DIMENSIONS, np.sqrt(np.mean(errors**2, axis=0)), strict=True))
    assert ratio["u"] < 1.3
    assert ratio["w"] < 1.3


@BOTH
def test_errors_scale_with_the_noise_however_strong_the_echo_is(estimator):
    some, strong = (errors_over_bound(estimator(), gained_db, range(1)) for gained_db in (50.0, 100.0))
    np.testing.assert_allclose(strong, some, atol=0.05)
    assert np.abs(some).max() < 4
