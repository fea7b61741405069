"""Rows and their clouds stay together, whatever is done to them."""

import numpy as np
import pandas as pd
from hypothesis import given
from hypothesis import strategies as st

from isacbench.bench.cells.record import CLOUD_KEYS
from isacbench.bench.store.rows import Rows
from isacbench.model.cloud_files.columns import POINT_COLUMNS

sizes = st.lists(st.integers(0, 3), max_size=6)


def rows_of(n_points, first_trial=0):
    """Rows of which row i, of its own trial, has the points i.0, i.1, ..."""
    n = len(n_points)
    trials = np.arange(first_trial, first_trial + n)
    records = pd.DataFrame(
        {"scenario": "tiny", "estimator": "good", "params": "{}", "snr_db": 0.0, "trial": trials}
    )
    firsts = np.repeat(trials, n_points)
    nth = np.concatenate([np.arange(count) for count in n_points] or [np.empty(0)])
    points = np.repeat((firsts + nth / 10)[:, None], 5, axis=1).reshape(-1, 5)
    return Rows(records, np.array(n_points, dtype=np.int64), points, {str(first_trial): {}})


def clouds_of(rows):
    """Trial and points of every row, by slices."""
    ends = np.cumsum(rows.n_points)
    return [
        (int(trial), rows.points[end - count : end].tolist())
        for trial, count, end in zip(rows.records["trial"], rows.n_points, ends, strict=True)
    ]


@given(sizes, st.data())
def test_rows_that_are_picked_bring_their_clouds(n_points, data):
    rows = rows_of(n_points)
    picked = data.draw(st.lists(st.integers(0, len(rows) - 1), max_size=8)) if n_points else []
    whole = clouds_of(rows)
    assert clouds_of(rows.take(np.array(picked, dtype=np.int64))) == [whole[index] for index in picked]


@given(sizes, st.data())
def test_a_mask_picks_what_its_indices_pick(n_points, data):
    rows = rows_of(n_points)
    mask = np.array(
        data.draw(st.lists(st.booleans(), min_size=len(rows), max_size=len(rows))), dtype=np.bool_
    )
    assert clouds_of(rows.take(mask)) == clouds_of(rows.take(np.flatnonzero(mask)))


@given(st.lists(sizes, max_size=3))
def test_joined_rows_are_those_of_all_parts(parts):
    starts = np.cumsum([0, *map(len, parts)])
    split = [rows_of(n_points, int(start)) for n_points, start in zip(parts, starts[:-1], strict=True)]
    joined = Rows.joined(split)
    assert clouds_of(joined) == [cloud for rows in split for cloud in clouds_of(rows)]
    assert set(joined.environments) == {name for rows in split for name in rows.environments}


@given(sizes, st.randoms(use_true_random=False))
def test_a_table_of_points_finds_its_rows_in_any_order(n_points, shuffler):
    rows = rows_of(n_points)
    order = list(range(len(rows)))
    shuffler.shuffle(order)
    table = rows.take(np.array(order, dtype=np.int64)).clouds()
    assert clouds_of(Rows.of_tables(rows.records, table, {})) == clouds_of(rows)


def test_points_of_cells_that_are_not_there_are_left_out():
    rows = rows_of([2, 1, 3])
    some = rows.take(np.array([0, 2]))
    assert clouds_of(Rows.of_tables(some.records, rows.clouds(), {})) == clouds_of(some)


def test_the_table_of_points_has_the_key_of_a_cell_with_every_point():
    table = rows_of([2, 0, 1]).clouds()
    assert table.columns.tolist() == [*CLOUD_KEYS, *POINT_COLUMNS]
    assert table["trial"].tolist() == [0, 0, 2]
    assert table["x"].tolist() == [0.0, 0.1, 2.0]


def test_no_rows_are_rows_too():
    empty = Rows.joined([])
    assert len(empty) == len(Rows.joined([empty, empty])) == 0
    assert empty.clouds().empty
    assert len(empty.take(np.empty(0, dtype=np.int64))) == 0
