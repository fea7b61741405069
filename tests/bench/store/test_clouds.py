"""Clouds stay with their rows, whatever is done to these."""

import numpy as np
import pandas as pd
from hypothesis import given
from hypothesis import strategies as st

from isacbench.bench.cells.rows import CLOUD_KEYS
from isacbench.bench.store.run import Run
from isacbench.bench.store.run_folder import cloud_table, clouds_of
from isacbench.model.cloud_files.tables import POINT_COLUMNS

sizes = st.lists(st.integers(0, 3), max_size=6)


def run_of(n_points, first_trial=0):
    """Run of which row i, of its own trial, has the points i.0, i.1, ..."""
    trials = np.arange(first_trial, first_trial + len(n_points))
    rows = pd.DataFrame(
        {"scenario": "tiny", "estimator": "good", "params": "{}", "snr_db": 0.0, "trial": trials}
    )
    nth = np.concatenate([np.arange(count) for count in n_points] or [np.empty(0)])
    points = np.repeat((np.repeat(trials, n_points) + nth / 10)[:, None], 5, axis=1).reshape(-1, 5)
    clouds = np.split(points, np.cumsum(n_points, dtype=int))[:-1]
    return Run("run", rows, {"environments": {str(first_trial): {}}}, read_clouds=lambda: clouds)


def by_trial(run):
    """Trial and points of every row."""
    clouds = [cloud.tolist() for cloud in run.points]
    return list(zip(run.rows["trial"].tolist(), clouds, strict=True))


@given(sizes, st.data())
def test_rows_that_are_picked_bring_their_clouds(n_points, data):
    run = run_of(n_points)
    picked = data.draw(st.lists(st.integers(0, len(n_points) - 1), max_size=8)) if n_points else []
    whole = by_trial(run)
    assert by_trial(run.take(np.array(picked, dtype=np.int64))) == [whole[index] for index in picked]


@given(sizes, st.data())
def test_a_mask_picks_what_its_indices_pick(n_points, data):
    n, run = len(n_points), run_of(n_points)
    mask = np.array(data.draw(st.lists(st.booleans(), min_size=n, max_size=n)), dtype=np.bool_)
    assert by_trial(run.take(mask)) == by_trial(run.take(np.flatnonzero(mask)))


@given(st.lists(sizes, max_size=3))
def test_joined_rows_are_those_of_all_parts(parts):
    starts = np.cumsum([0, *map(len, parts)])
    split = [run_of(n_points, int(start)) for n_points, start in zip(parts, starts[:-1], strict=True)]
    joined = Run.joined(split)
    every = [one for run in split for one in by_trial(run)]
    assert by_trial(joined) == every if every else joined.rows.empty
    assert set(joined.environments) == {name for run in split for name in run.environments}


@given(sizes, st.randoms(use_true_random=False), st.integers(0, 3))
def test_a_table_of_points_finds_its_rows_in_any_order_and_leaves_others_out(n_points, shuffler, n_gone):
    run = run_of(n_points)
    order = list(range(len(n_points)))
    shuffler.shuffle(order)
    other, some = run.take(np.array(order, dtype=np.int64)), run.take(np.arange(len(n_points))[n_gone:])
    found = clouds_of(some.rows, cloud_table(other.rows, other.points))
    assert [cloud.tolist() for cloud in found] == [cloud.tolist() for cloud in some.points]


def test_the_table_of_points_has_the_key_of_a_cell_with_every_point():
    run = run_of([2, 0, 1])
    table = cloud_table(run.rows, run.points)
    assert table.columns.tolist() == [*CLOUD_KEYS, *POINT_COLUMNS]
    assert table["trial"].tolist() == [0, 0, 2]
    assert table["x"].tolist() == [0.0, 0.1, 2.0]
