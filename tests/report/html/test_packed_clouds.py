"""Clouds in a page: unpacked, they are what was packed, and the rule keeps the most wanted ones."""

import itertools

import numpy as np
import pandas as pd
from hypothesis import given
from hypothesis import strategies as st

from isacbench.report.html.page_content import LEVELS, POWER_LEVELS, choose_clouds, pack_clouds

places = st.floats(-1e4, 1e4, allow_nan=False, width=32)
point = st.tuples(places, places, places, st.floats(-50, 50), st.floats(1e-12, 1e12))
clouds = st.lists(st.lists(point, max_size=6), min_size=1, max_size=5)


def unpacked(content, counts):
    """Clouds as the script of a page reads them: x, y, z, v, power in dB."""
    n = int(np.sum(counts))
    limits = np.frombuffer(content, "<f4", 10 * len(counts)).reshape(-1, 5, 2).astype(float)
    planes = np.frombuffer(content, np.uint8, offset=40 * len(counts)).reshape(9, n).astype(float)
    steps = [256 * planes[2 * axis] + planes[2 * axis + 1] for axis in range(4)] + [planes[8]]
    own = np.repeat(limits, counts, axis=0)
    return np.stack([own[:, axis, 0] + own[:, axis, 1] * steps[axis] for axis in range(5)], axis=1)


@given(clouds)
def test_a_cloud_comes_back_within_half_a_step_of_its_own_extent(listed):
    counts = np.array([len(cloud) for cloud in listed])
    points = np.array([point for cloud in listed for point in cloud], dtype=float).reshape(-1, 5)
    found = unpacked(pack_clouds(points, counts), counts)
    wanted = points.copy()
    wanted[:, 4] = 10 * np.log10(points[:, 4])
    of_cloud = np.repeat(np.arange(len(counts)), counts)
    for number in range(len(counts)):
        own, other = wanted[of_cloud == number], found[of_cloud == number]
        if len(own):
            step = np.ptp(own, axis=0) / [LEVELS, LEVELS, LEVELS, LEVELS, POWER_LEVELS]
            rounding = 3e-7 * np.abs(own).max(axis=0)  # limits are stored in single precision
            assert np.all(np.abs(own - other) <= 0.51 * step + rounding + 1e-9)


def test_a_point_without_power_is_the_weakest_and_not_infinite():
    points = np.array([[0.0, 0, 0, 0, 0], [1, 1, 1, 1, 1]])
    assert np.isfinite(unpacked(pack_clouds(points, np.array([2])), [2])).all()


def rows(n_trials=3, snrs_db=(0.0, 11.0), scenarios=("a", "b")):
    cells = list(itertools.product(scenarios, snrs_db, range(n_trials)))
    table = pd.DataFrame(cells, columns=["scenario", "snr_db", "trial"])
    return table.assign(estimator="one", params="{}", deviation=10.0 * table["trial"] + table["snr_db"])


def test_clouds_that_fit_are_all_in_the_page():
    table = rows()
    assert choose_clouds(table, np.full(len(table), 5), most_points=5 * len(table)).all()


def test_of_too_many_clouds_the_page_holds_what_is_looked_at_first():
    table = rows()
    n_points, key = np.full(len(table), 5), ["scenario", "snr_db", "trial"]

    def held(n_clouds, first=None):
        chosen = choose_clouds(table, n_points, first, most_points=5 * n_clouds)
        return {tuple(row) for row in table.loc[chosen, key].itertuples(index=False)}

    assert held(2) == {("a", 11.0, 0), ("b", 11.0, 0)}
    assert held(4) - held(2) == {("a", 11.0, 2), ("b", 11.0, 2)}  # of largest deviation
    assert held(6) - held(4) == {("a", 0.0, 0), ("b", 0.0, 0)}
    wanted = ((table["scenario"] == "b") & (table["trial"] == 1)).to_numpy()
    assert held(2, wanted) == {("b", 0.0, 1), ("b", 11.0, 1)}


def test_a_cell_that_failed_is_never_the_one_of_largest_deviation():
    table = rows().assign(deviation=np.nan)
    assert choose_clouds(table, np.full(len(table), 5), most_points=20).sum() == 4
