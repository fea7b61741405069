"""`music2d_joint` and `esprit2d` from echo to image: close pairs, the Cramér-Rao bound, symmetries."""

from dataclasses import replace

import numpy as np
import pytest
from isacbench_algorithms.esprit2d import Esprit2d
from isacbench_algorithms.music2d_joint import Music2dJoint

from isacbench.bench.cells.cell import MeasuredImage
from isacbench.bench.kinds.efficiency import BOUNDS, ERRORS
from isacbench.bench.kinds.efficiency import measure_efficiency as measure_error
from isacbench.model.echo import Simulator
from isacbench.model.radio_coordinates import DIMENSIONS, draw_place, gain_db, space_places
from isacbench.model.scene import Scatterers
from isacbench.model.scenes.scenario import load_scenario

BOTH = pytest.mark.parametrize("estimator", [Esprit2d, Music2dJoint])


def image(scenario, estimator, gained_db, trial):
    """Shot of a scenario at an SNR after all gains of one unit scatterer."""
    snr_db = gained_db - gain_db(scenario)
    observation = Simulator(scenario).observe(snr_db, trial)
    return MeasuredImage(scenario, observation, estimator, snr_db, estimator.estimate(observation))


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
