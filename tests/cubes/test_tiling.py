"""Boxes and progressions against plain loops."""

from itertools import pairwise
from math import prod

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from isacbench.cubes.tiles import box_lengths, extents, pick, progressions

lengths = st.tuples(st.integers(1, 50), st.integers(1, 9), st.integers(1, 9))


@given(lengths=lengths, nesting=st.permutations(range(3)), cells=st.integers(0, 3000))
def test_a_box_fits_and_is_cut_along_the_outermost_axes_alone(lengths, nesting, cells):
    box = box_lengths(lengths, nesting, cells)
    assert prod(box) <= max(cells, 1)
    for place, axis in enumerate(nesting):
        if box[axis] < lengths[axis]:
            assert all(box[outer] == 1 for outer in nesting[:place])


@given(
    lengths=st.tuples(st.integers(1, 9), st.integers(1, 9)),
    sizes=st.lists(st.integers(1, 5), min_size=1, max_size=4),
    box=st.tuples(st.integers(1, 10), st.integers(1, 10), st.integers(1, 10)),
    nesting=st.permutations(range(3)),
)
def test_extents_cover_everything_once_and_change_fastest_along_the_innermost_axis(
    lengths, sizes, box, nesting
):
    groups = np.split(np.random.default_rng(0).permutation(sum(sizes)), np.cumsum(sizes)[:-1])
    covered = np.zeros((*lengths, sum(sizes)), int)
    places = []
    for n, m, elements in extents(lengths, groups, box, nesting):
        covered[n, m, elements] += 1
        assert any({*elements} <= {*group} for group in groups)
        position = int(np.flatnonzero(np.concatenate(groups) == elements[0])[0])
        places.append(tuple((n.start, m.start, position)[axis] for axis in nesting))
    assert (covered == 1).all()
    assert places == sorted(places)


@given(st.lists(st.integers(-4, 4), max_size=20))
def test_progressions_cover_a_sequence_and_have_one_step_each(values):
    runs = progressions(np.array(values, dtype=np.intp))
    assert [k for run in runs for k in range(run.start, run.stop)] == [*range(len(values))]
    assert all(len({*np.diff(values[run])}) <= 1 for run in runs)
    for run, following in pairwise(runs):
        assert run.stop - run.start >= 2
        assert following.start == run.stop
        assert values[run.stop] - values[run.stop - 1] != values[run.start + 1] - values[run.start]


def test_equidistant_elements_are_picked_as_views():
    block = np.arange(2 * 3 * 4 * 5).reshape(2, 3, 4, 5)
    row, column, diagonal = [[1, q] for q in range(5)], [[p, 2] for p in range(4)], [[k, k] for k in range(4)]
    for elements in (row, row[::-1], column, diagonal, [[3, 4]]):
        picked = pick(block, np.array(elements))
        assert np.shares_memory(picked, block)
        assert np.array_equal(picked, block[:, :, *np.transpose(elements)])
    bent = np.array([*row, *column])
    assert not np.shares_memory(pick(block, bent), block)
    assert np.array_equal(pick(block, bent), block[:, :, *bent.T])
