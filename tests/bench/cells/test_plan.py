"""The plan: every cell has one place, belongs to one part, and is handed out once."""

from dataclasses import dataclass
from itertools import groupby

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.bench.cells.plan import Plan, Shard, pieces
from isacbench.bench.cells.task import Entry
from isacbench.errors import InputError


@dataclass(frozen=True)
class Task:
    """What a plan wants to know of a task."""

    name: str
    snr_db: list[float]
    entries: list[Entry]


@st.composite
def plans(draw):
    names = draw(st.lists(st.text(min_size=1), min_size=1, max_size=3, unique=True))
    finite = st.floats(allow_nan=False, allow_infinity=False)
    tasks = []
    for name in names:
        snr_db = draw(st.lists(finite, min_size=1, max_size=4, unique=True))
        keys = draw(
            st.lists(
                st.tuples(st.sampled_from("ab"), st.text(max_size=2)), min_size=1, max_size=4, unique=True
            )
        )
        tasks.append(Task(name, snr_db, [Entry(*key, plugin=None) for key in keys]))
    return Plan(tasks, draw(st.integers(1, 4)))


def every_cell(plan):
    """Keys of all cells, by loops."""
    return pd.DataFrame(
        [
            (task.name, one.name, one.params, snr_db, trial)
            for task in plan.tasks
            for trial in range(plan.n_trials)
            for snr_db in task.snr_db
            for one in task.entries
        ],
        columns=["scenario", "estimator", "params", "snr_db", "trial"],
    )


def cells_of(plan, blocks):
    """Keys of the cells of blocks."""
    return [(*block[:3], *key) for block in blocks for key in block.entries]


def marks(plan, data):
    drawn = data.draw(st.lists(st.booleans(), min_size=plan.n_cells, max_size=plan.n_cells))
    return np.array(drawn, dtype=np.bool_)


@given(plans(), st.randoms(use_true_random=False))
def test_the_position_of_a_cell_is_its_place_in_the_table_whoever_asks_in_which_order(plan, shuffler):
    cells = every_cell(plan)
    order = list(range(len(cells)))
    assert plan.n_cells == len(cells)
    np.testing.assert_array_equal(plan.positions(cells), order)
    shuffler.shuffle(order)
    np.testing.assert_array_equal(plan.positions(cells.iloc[order]), order)


@given(plans(), st.data())
def test_a_cell_that_the_plan_does_not_have_has_no_position(plan, data):
    cells = every_cell(plan)
    column, stranger = data.draw(
        st.sampled_from(
            [
                ("scenario", "\0none"),
                ("estimator", "c"),
                ("params", "none"),
                ("trial", plan.n_trials),
                ("trial", -1),
            ]
        )
    )
    cells[column] = stranger
    assert (plan.positions(cells) == -1).all()


@given(plans(), st.data())
def test_blocks_hold_the_marked_cells_each_once_and_in_order(plan, data):
    todo = marks(plan, data)
    blocks = plan.blocks(todo)
    everything = cells_of(plan, plan.blocks())
    assert cells_of(plan, blocks) == [cell for cell, marked in zip(everything, todo, strict=True) if marked]
    assert all(block.entries for block in blocks)
    assert len({block[:3] for block in blocks}) == len(blocks)


@given(plans(), st.integers(1, 12))
def test_parts_share_the_cells_and_none_is_empty_while_another_has_two_observations(plan, n):
    parts = np.array([plan.shard(Shard(k, n)) for k in range(1, n + 1)])
    np.testing.assert_array_equal(parts.sum(axis=0), 1)
    sizes = [len(plan.blocks(part)) for part in parts]
    n_trials = sum(1 for _ in groupby(plan.blocks(), lambda b: b[:2]))
    if n_trials >= n:
        assert min(sizes) > 0
    else:
        assert max(sizes) - min(sizes) <= 1


@given(plans(), st.integers(0, 12), st.data())
def test_pieces_are_trials_in_order_or_single_blocks_where_trials_are_too_few(plan, n, data):
    blocks = plan.blocks(marks(plan, data))
    handed_out = pieces(blocks, n)
    assert [block for piece in handed_out for block in piece] == blocks
    trials = {block[:2] for block in blocks}
    assert len(handed_out) == (len(trials) if len(trials) >= n else len(blocks))
    assert all(len({block[:2] for block in piece}) == 1 for piece in handed_out)


@given(st.integers(1, 99), st.integers(1, 99))
def test_a_shard_is_read_as_it_is_written(k, n):
    k, n = sorted((k, n))
    assert Shard.parse(f"{k}/{n}") == Shard(k, n)


@pytest.mark.parametrize(
    "text", ["", "1", "/", "0/3", "4/3", "1/0", "-1/3", "1/3/5", "a/b", "1.0/2", " 1/2", "1/²", "１/３"]
)
def test_a_shard_that_is_none_is_refused(text):
    with pytest.raises(InputError, match="allowed is k/n with 1 <= k <= n"):
        Shard.parse(text)
