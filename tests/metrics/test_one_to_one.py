"""One-to-one scores: matchings against plain loops and Stone Soup, merged truth, invariances."""

import dataclasses
import math
from datetime import datetime

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial import cKDTree

from isacbench import load_scenario
from isacbench.errors import InputError, InputWarning
from isacbench.metrics.assignment import Pairs, cheapest, connected_pieces, most_pairs, near_pairs, pair_gospa
from isacbench.metrics.geometry import CloudPair
from isacbench.metrics.one_to_one import MERGED_CELLS, RADII_M, OneToOne, merged_truth, score_curve
from isacbench.model.cloud import PointCloud
from isacbench.model.radio_coordinates import radio_places, rayleigh_cells
from isacbench.model.region import Region
from tests.single_scores import all_matchings

REGION = Region((0.0, 9.0), (0.0, 9.0), (0.0, 9.0), (-5.0, 5.0))
STREET = load_scenario("street")
pytestmark = pytest.mark.filterwarnings("ignore:the truth is not merged")


def cloud_of(rng, n, size_m=3.0):
    return PointCloud(rng.uniform(0, size_m, (n, 3)), rng.uniform(-5, 5, n), np.ones(n))


seeds = st.integers(0, 10_000)
sizes = st.integers(0, 4)


@given(seed=seeds, n=st.integers(1, 4), m=sizes, radius_m=st.sampled_from([0.5, 1.0, 2.0]))
def test_scores_are_those_of_the_best_of_all_matchings(seed, n, m, radius_m):
    rng = np.random.default_rng(seed)
    truth, estimate = cloud_of(rng, n), cloud_of(rng, m)
    d2 = ((truth.xyz[:, None] - estimate.xyz[None]) ** 2).sum(axis=2)
    inside = [one for one in all_matchings(n, m) if all(d2[i, j] <= radius_m**2 for i, j in one)]
    k = max(map(len, inside))
    nearest = min((one for one in inside if len(one) == k), key=lambda one: sum(d2[i, j] for i, j in one))
    gospa2 = min(sum(d2[i, j] for i, j in one) + radius_m**2 / 2 * (n + m - 2 * len(one)) for one in inside)
    clipped = np.minimum(d2, radius_m**2)
    ospa2 = min(sum(clipped[i, j] for i, j in one) for one in all_matchings(n, m) if len(one) == min(n, m))
    ospa2 = (ospa2 + radius_m**2 * abs(n - m)) / max(n, m)
    found = OneToOne().score(CloudPair(truth, estimate, REGION, radius_m=radius_m))
    assert found["f_score"] == pytest.approx(2 * k / (n + m))
    assert found["matched_precision"] == pytest.approx(k / max(m, 1))
    assert found["matched_recall"] == pytest.approx(k / n)
    assert found["gospa_skill"] == pytest.approx(1 - gospa2 / (radius_m**2 / 2 * n))
    parts = found["gospa_localisation"] + found["gospa_missed"] + found["gospa_false"]
    assert parts == pytest.approx(gospa2 / (radius_m**2 / 2 * n))
    assert found["ospa_m"] == pytest.approx(math.sqrt(ospa2))
    errors = [estimate.velocity[j] - truth.velocity[i] for i, j in nearest]
    worst = np.ptp([*truth.velocity, -5.0, 5.0])
    assert found["velocity_error_mps"] == pytest.approx(np.sqrt(np.mean(np.square(errors))) if k else worst)


@given(seed=seeds, n=st.integers(1, 30), m=st.integers(0, 30))
def test_gospa_and_ospa_are_those_of_stone_soup(seed, n, m):
    from stonesoup.metricgenerator.ospametric import GOSPAMetric, OSPAMetric
    from stonesoup.types.state import State

    rng, when = np.random.default_rng(seed), datetime(2026, 1, 1)
    truth, estimate = cloud_of(rng, n), cloud_of(rng, m)
    states = [[State(point, timestamp=when) for point in one.xyz] for one in (estimate, truth)]
    gospa = pair_gospa(CloudPair(truth, estimate, radius_m=0.8))
    parts = GOSPAMetric(p=2, c=0.8).compute_gospa_metric(*states)[0].value
    assert gospa.distance_m == pytest.approx(parts["distance"])
    assert gospa.localisation_m2 == pytest.approx(parts["localisation"], abs=1e-12)
    # Stone Soup assigns by distances and then adds their squares, which is no less than the least sum.
    their_ospa_m = OSPAMetric(p=2, c=0.8).compute_OSPA_distance(*states).value
    assert their_ospa_m * 0.95 <= gospa.ospa_m <= their_ospa_m + 1e-12


@given(seed=seeds, n=st.integers(1, 8))
def test_parts_far_from_each_other_are_scored_like_the_parts_together(seed, n):
    """The matched pairs of two images side by side are those of each."""
    rng = np.random.default_rng(seed)
    parts = [(cloud_of(rng, n), cloud_of(rng, n + 1)) for _ in range(2)]
    alone = [pair_gospa(CloudPair(*part)) for part in parts]
    joined = (np.vstack([one.xyz, other.xyz + 100.0]) for one, other in zip(*parts, strict=True))
    together = pair_gospa(CloudPair(*map(PointCloud, joined)))
    assert together.distance_m**2 == pytest.approx(sum(one.distance_m**2 for one in alone))
    assert together.n_matched == sum(one.n_matched for one in alone)


def test_the_curve_rises_with_the_radius_and_its_area_is_the_mean_over_its_logarithm():
    rng = np.random.default_rng(2)
    near = PointCloud(STREET.truth.xyz + rng.normal(0, 0.5, STREET.truth.xyz.shape), STREET.truth.velocity)
    pair = CloudPair.of(STREET, near)
    curve = score_curve(pair)
    np.testing.assert_allclose(curve.radius_m, RADII_M)
    assert (np.diff(curve.f_score) >= 0).all()
    widths = np.diff(np.log(curve.radius_m))
    area = sum(widths * (curve.f_score[1:] + curve.f_score[:-1]) / 2) / widths.sum()
    found = OneToOne().score(pair)
    assert found["f_score_area"] == pytest.approx(area)
    at_1_m = np.interp(0.0, np.log(curve.radius_m), curve.f_score)
    assert found["f_score"] == pytest.approx(at_1_m, abs=0.05)


def test_scatterers_are_merged_where_all_of_them_fit_into_half_a_cell_and_no_two_groups_do():
    merged, places = merged_truth(STREET), radio_places(STREET, STREET.truth)
    cells = MERGED_CELLS * rayleigh_cells(STREET)
    assert merged.power.sum() == pytest.approx(STREET.truth.power.sum())
    # Complete linkage: a scatterer that is within half a cell of no other stays as it is.
    apart = (np.abs(places[:, None] - places[None]) / cells).max(axis=2)
    np.fill_diagonal(apart, np.inf)
    alone = STREET.truth.xyz[apart.min(axis=1) > 1]
    assert cKDTree(merged.xyz).query(alone)[0].max() < 1e-9
    assert len(alone) < len(merged) < len(STREET.truth)


def test_a_mirrored_street_has_as_many_merged_scatterers():
    """A lattice would not: its borders lie elsewhere."""
    scatterers, (low, high) = STREET.scatterers, STREET.region.x_m
    mirrored = dataclasses.replace(scatterers, xyz=scatterers.xyz * [-1, 1, 1] + [low + high, 0, 0])
    place = STREET.base_station_m * [-1, 1, 1] + [low + high, 0, 0]
    twin = dataclasses.replace(STREET, scatterers=mirrored, base_station_m=place)
    assert len(merged_truth(twin)) == pytest.approx(len(merged_truth(STREET)), rel=0.02)


@given(seed=seeds, n=st.integers(2, 200), size=st.sampled_from([1.5, 3.0, 6.0]), n_axes=st.integers(1, 4))
def test_pieces_are_those_of_single_linkage_crowded_or_not(seed, n, size, n_axes):
    rng = np.random.default_rng(seed)
    clumps = rng.uniform(0, size, (4, n_axes)) * [[1], [1], [2], [2]]
    places = np.concatenate([rng.uniform(0, size, (n // 2, n_axes)), rng.choice(clumps, n - n // 2)])
    places += rng.choice([0, 0.1]) * rng.standard_normal(places.shape)
    group = fcluster(linkage(places, "single", metric="chebyshev"), 1.0, "distance")
    pieces = connected_pieces(places)
    assert [members[0] for members in pieces] == sorted(np.unique(group, return_index=True)[1].tolist())
    for members in pieces:
        np.testing.assert_array_equal(members, np.flatnonzero(group == group[members[0]]))


def test_a_crowd_at_one_place_is_a_piece_without_the_pairs_of_all():
    crowd = np.repeat([[0.5, 0.5], [1.4, 1.4], [2.5, 2.5]], 30_000, axis=0)
    assert [members.size for members in connected_pieces(crowd)] == [60_000, 30_000]


def test_the_largest_matching_is_found_where_the_nearest_first_would_miss_it():
    pairs = Pairs(np.array([0, 0, 1]), np.array([0, 1, 0]), np.array([0.0, 1.0, 1.0]))
    assert most_pairs(pairs) == 2
    assert cheapest(pairs, pairs.squared_m2, math.inf).tolist() == [1, 2]
    assert cheapest(pairs, pairs.squared_m2, 1.0).tolist() == [0]


def test_many_pairs_have_a_largest_matching_of_the_same_size(monkeypatch):
    random = np.random.default_rng(0)
    trees = [cKDTree(random.uniform(0, 3, (60, 3))) for _ in range(2)]
    pairs = [near_pairs(*trees, radius_m, "matching") for radius_m in (0.3, 0.6, 1.0)]
    few = [most_pairs(one) for one in pairs]
    monkeypatch.setattr("isacbench.metrics.assignment.MANY_PAIRS", 0)
    assert [most_pairs(one) for one in pairs] == few


def test_too_dense_clouds_are_left_out_in_words(monkeypatch):
    monkeypatch.setattr("isacbench.metrics.assignment.MOST_PAIRS", 3)
    pair = CloudPair(*(cloud_of(np.random.default_rng(seed), 5) for seed in (0, 1)), radius_m=3.9)
    with pytest.warns(InputWarning) as warned:
        assert math.isnan(OneToOne().score(pair)["f_score"])
    messages = [str(each.message) for each in warned]
    assert any(text.startswith("F-score of 5 true and 5 estimated points is left") for text in messages)
    monkeypatch.setattr("isacbench.metrics.one_to_one.MOST_MERGED", 5)
    merged_truth.cache_clear()
    with pytest.raises(InputError, match=r"street: \d+ scatterers hang together; allowed are at most 5"):
        merged_truth(STREET)
    assert near_pairs(pair.truth_tree, pair.estimate_tree, 1e-6, "x").i.size == 0


def test_a_cloud_too_dense_for_the_curve_has_all_scores_at_its_radius(monkeypatch):
    line = np.column_stack([np.arange(40.0) * 1.5, np.zeros((40, 2))])
    pair = CloudPair(PointCloud(line, np.ones(40)), PointCloud(line + 0.1, np.ones(40)))
    with pytest.warns(InputWarning, match="not merged"):
        expected = OneToOne().score(dataclasses.replace(pair))
    monkeypatch.setattr("isacbench.metrics.assignment.MOST_PAIRS", 100)
    with pytest.warns(InputWarning, match="f_score_area of 40 true and 40 estimated points is left out"):
        found = OneToOne().score(dataclasses.replace(pair))
    assert math.isnan(found.pop("f_score_area"))
    assert found == {name: value for name, value in expected.items() if name != "f_score_area"}


def test_without_a_scenario_the_truth_is_not_merged_and_a_warning_says_so():
    with pytest.warns(InputWarning, match="the truth is not merged .* give a scenario"):
        OneToOne().score(CloudPair(STREET.truth, STREET.truth))
