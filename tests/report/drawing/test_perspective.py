from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure

from isacbench.report.drawing.perspective import (
    MARGINS_IN,
    Box,
    View,
    perspective_axes,
    scatter,
    tick_places,
    tick_step,
)

WIDTH_IN, HEIGHT_IN = 3.5, 2.6
edges_m = st.floats(2.0, 1000.0)
BOX = Box(np.array([0.0, -5.0, 2.0]), np.array([30.0, 15.0, 12.0]))


def corners_of(box):
    return np.array(np.meshgrid(*np.transpose([box.lower_m, box.upper_m]))).reshape(3, 8).T


@given(st.tuples(edges_m, edges_m, edges_m))
def test_any_box_touches_the_margins_and_stays_inside_them(size_m):
    box = Box(np.full(3, -7.0), np.array(size_m) - 7)
    corners = View(box, WIDTH_IN, HEIGHT_IN).project(corners_of(box))
    lower, upper = corners.min(axis=0), corners.max(axis=0)
    room = [
        lower[0] - MARGINS_IN["left"],
        WIDTH_IN - MARGINS_IN["right"] - upper[0],
        lower[1] - MARGINS_IN["bottom"],
        HEIGHT_IN - MARGINS_IN["top"] - upper[1],
    ]
    assert min(room) == pytest.approx(0, abs=1e-9)


def test_all_directions_have_one_scale_at_the_middle_of_the_box():
    view, middle = View(BOX, WIDTH_IN, HEIGHT_IN), (BOX.lower_m + BOX.upper_m) / 2
    step_m = 1e-5
    derivative = (view.project(middle + step_m * np.eye(3)) - view.project(middle)).T / step_m
    gram = derivative @ derivative.T
    np.testing.assert_allclose(gram, gram[0, 0] * np.eye(2), atol=1e-4 * gram[0, 0])


def test_straight_lines_stay_straight_and_the_nearer_half_is_the_longer():
    view = View(BOX, WIDTH_IN, HEIGHT_IN)
    line = np.linspace([0.0, 15.0, 2.0], [30.0, -5.0, 2.0], 3)
    far, middle, near = view.project(line)
    assert np.cross([*(middle - far), 0], [*(near - middle), 0])[2] == pytest.approx(0, abs=1e-9)
    nearness = view.nearness_m(line)
    assert nearness[0] < nearness[1] < nearness[2]
    assert np.linalg.norm(near - middle) > np.linalg.norm(middle - far)


def test_upwards_is_upwards():
    low, high = View(BOX, WIDTH_IN, HEIGHT_IN).project([[10, 0, 2], [10, 0, 12]])
    assert high[1] > low[1]


def test_nearer_points_are_drawn_over_farther_ones_in_their_own_colours():
    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN))
    axes, view = perspective_axes(figure, figure.add_gridspec(1, 1)[0, 0], BOX)
    points = np.array([[30.0, -5.0, 2.0], [0.0, 15.0, 2.0], [15.0, 5.0, 7.0]])
    colours = np.array([[1.0, 0, 0, 1], [0, 1.0, 0, 1], [0, 0, 1.0, 1]])
    scatter(axes, view, points, colours)
    drawn = axes.collections[-1]
    np.testing.assert_allclose(drawn.get_offsets(), view.project(points[[1, 2, 0]]))
    np.testing.assert_array_equal(drawn.get_facecolors(), colours[[1, 2, 0]])


@given(st.tuples(edges_m, edges_m, edges_m))
def test_the_longest_edge_has_few_ticks_at_round_places(size_m):
    box = Box(np.zeros(3), np.array(size_m))
    step = tick_step(box, 4)
    places = tick_places(0.0, max(size_m), step)
    assert 2 <= places.size <= 5
    np.testing.assert_allclose(places / step, np.arange(places.size))
    assert not np.signbit(places).any()


@pytest.mark.parametrize(
    "corners_m",
    [
        ([0, 0, 0], [20, 20, 10]),  # a tick at the upper end of z
        ([0, 0, 0], [40, 20, 2]),
        ([0, 0, 0], [10, 10, 100]),
        ([-100, -100, -20], [100, 20, 100]),
        ([10, 10, 4], [12, 12, 6]),
        ([400, -300, 100], [1000, 20, 1100]),
    ],
)
def test_numbers_and_names_of_a_box_overprint_nothing(corners_m):
    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), dpi=150)
    place = figure.add_gridspec(1, 1, left=0, right=1, bottom=0, top=1)[0, 0]
    axes, _ = perspective_axes(figure, place, Box(*np.array(corners_m, dtype=float)))
    # Names along slanted edges have boxes much larger than their letters.
    texts = [text for text in axes.texts if text.get_text() not in ("x [m]", "y [m]")]
    assert "z [m]" in [text.get_text() for text in texts]
    for one, other in combinations(texts, 2):
        # Lines of text are higher than digits.
        letters = one.get_window_extent().padded(0, -2)
        assert not letters.overlaps(other.get_window_extent().padded(0, -2)), f"{one} over {other}"


def test_zero_has_no_sign_and_both_ends_are_included():
    assert str(tick_places(-5.0, 10.0, 5.0).tolist()) == "[-5.0, 0.0, 5.0, 10.0]"
