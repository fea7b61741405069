"""Games that a ranking could be won by without a better image; none of them is."""

from functools import cache

import numpy as np
import pytest
from scipy.spatial import cKDTree

from isacbench import get_estimator, load_scenario, observe
from isacbench.bench.compare.significance import rank_sets
from isacbench.metrics.geometry import CloudPair
from isacbench.metrics.object_scores import Objects
from isacbench.metrics.one_to_one import OneToOne
from isacbench.metrics.paper import Paper
from isacbench.model.cloud import PointCloud

FAMILIES = "town", "facade", "crowd", "street", "traffic", "crossing"
SCENES = [f"{family}[seed=60]" for family in FAMILIES]
LEADING = {"ratio": -1, "f_score": 1, "velocity_error_mps": -1}
"""Scores of a ranking with the sign of their better direction, the one that it goes by first."""


def joined(*clouds):
    parts = [[getattr(cloud, name) for cloud in clouds] for name in ("xyz", "velocity", "power")]
    return PointCloud(*map(np.concatenate, parts))


def shifted(cloud, offsets):
    return joined(*(PointCloud(cloud.xyz + offset, cloud.velocity, cloud.power) for offset in offsets))


def bridged(cloud):
    """Invent midpoints between near neighbours."""
    distance, index = cKDTree(cloud.xyz).query(cloud.xyz, k=2)
    near = np.flatnonzero(distance[:, 1] < 3)
    i, j = np.unique(np.sort(np.column_stack([near, index[near, 1]]), axis=1), axis=0).T
    middle = [
        (getattr(cloud, name)[i] + getattr(cloud, name)[j]) / 2 for name in ("xyz", "velocity", "power")
    ]
    return joined(cloud, PointCloud(*middle))


def dilated(cloud):
    """Put six points around each."""
    return shifted(cloud, np.vstack([np.zeros(3), 0.7 * np.eye(3), -0.7 * np.eye(3)]))


def padded(cloud):
    """Copy the strongest point 400 times."""
    return joined(cloud, *[cloud.select([int(cloud.power.argmax())])] * 400)


def pruned(cloud):
    """Drop isolated points."""
    return cloud.select(cKDTree(cloud.xyz).query(cloud.xyz, k=2)[0][:, 1] < 1.5)


def hedged(cloud):
    """Put 14 points 2 m around each."""
    around = np.random.default_rng(1).normal(size=(14, 3))
    return shifted(cloud, 2 * around / np.linalg.norm(around, axis=1, keepdims=True))


def halved(cloud):
    """Report half of each speed."""
    return PointCloud(cloud.xyz, cloud.velocity / 2, cloud.power)


def strongest(cloud):
    """Report the ten strongest points alone."""
    return cloud.select(np.argsort(-cloud.power)[:10])


GAMES = [bridged, dilated, padded, pruned, hedged, halved, strongest]


@cache
def scored(game=None):
    """Leading scores (n_scenes, 3) of a game, or of the plain estimator."""
    rows = []
    for name in SCENES:
        scenario, cloud = images()[name]
        pair = CloudPair.of(scenario, cloud if game is None else game(cloud))
        found = {"ratio": Paper().score(pair)["hausdorff_sum_m"], **OneToOne().score(pair)}
        rows.append([found[score] for score in LEADING])
    return np.array(rows)


@cache
def images():
    found = {}
    for name in SCENES:
        scenario = load_scenario(name)
        found[name] = scenario, get_estimator("music2d").estimate(observe(scenario, 10.0))
    return found


@pytest.mark.parametrize("game", GAMES, ids=[game.__name__ for game in GAMES])
def test_a_game_is_not_ranked_before_the_estimator_by_the_leading_score(game):
    """The denominator of the ratio is the oracle's; it is the same for both."""
    both = np.column_stack([scored()[:, 0], scored(game)[:, 0]])
    assert rank_sets(both).low[0] == 1


@pytest.mark.parametrize("game", GAMES, ids=[game.__name__ for game in GAMES])
def test_a_game_does_not_win_by_all_leading_scores_together(game):
    signs = np.array([*LEADING.values()])
    gain = (signs * (scored(game) - scored())).mean(axis=0)
    assert (gain < 0).any()


def test_each_game_is_caught_by_the_score_that_is_made_for_it():
    plain, column = scored().mean(axis=0), dict(zip(LEADING, range(3), strict=True))
    for game in (dilated, padded, hedged, strongest):
        assert scored(game).mean(axis=0)[column["f_score"]] < 0.8 * plain[column["f_score"]]
    for game in (bridged, halved):
        assert scored(game).mean(axis=0)[column["velocity_error_mps"]] > plain[column["velocity_error_mps"]]
    for game in (pruned, strongest):
        assert scored(game).mean(axis=0)[column["ratio"]] > plain[column["ratio"]]


def test_copies_of_a_point_do_not_change_the_objects():
    scenario, cloud = images()[SCENES[0]]
    plain, copied = (Objects().score(CloudPair.of(scenario, one)) for one in (cloud, padded(cloud)))
    assert copied["objects_f_score"] == plain["objects_f_score"]
