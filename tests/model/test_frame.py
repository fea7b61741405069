"""Frames: exact inverses in the half-space they see, and nothing outside the visible region."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from isacbench.errors import InputError
from isacbench.model.frame import PanelFrame, PaperFrame, get_frame

ANGLES = st.floats(-180, 180)
PANELS = st.builds(PanelFrame, yaw_deg=ANGLES, tilt_deg=st.floats(-89, 89))
FRAMES = st.one_of(st.just(PaperFrame()), PANELS)
COORDINATES = st.floats(-300, 300)


@st.composite
def offsets(draw):
    """Draw an offset from the base station, not at it."""
    offset = np.array([draw(COORDINATES) for _ in range(3)])
    assume(np.linalg.norm(offset) > 1e-3)
    return offset[None]


@st.composite
def cosines(draw):
    """Draw direction cosines inside the visible region, off its border."""
    radius, angle = draw(st.floats(1e-6, 0.999)), draw(st.floats(0, 2 * np.pi))
    return np.array([radius * np.cos(angle)]), np.array([radius * np.sin(angle)])


@given(FRAMES, offsets())
def test_an_offset_survives_the_way_to_direction_cosines_and_back(frame, offset):
    range_m = np.linalg.norm(offset, axis=1)
    u, w = frame.direction_cosines(offset)
    sine_to_border = np.sqrt(max(1 - u[0] ** 2 - w[0] ** 2, 0.0))
    assume(frame.in_half_space(offset)[0])
    if isinstance(frame, PaperFrame):
        assume(np.hypot(u, w)[0] > 1e-6)  # the horizon is singular
    # Near the border a rounding error of u costs its square root in the third coordinate.
    tolerance = range_m[0] * 1e-15 / max(sine_to_border, 3e-8) * 10
    np.testing.assert_allclose(frame.offsets(range_m, u, w), offset, rtol=0, atol=max(tolerance, 1e-11))


@given(FRAMES, cosines(), st.floats(0.1, 600))
def test_direction_cosines_survive_the_way_to_an_offset_and_back(frame, cosine, range_m):
    offset = frame.offsets([range_m], *cosine)
    assert frame.in_half_space(offset).all()
    assert np.linalg.norm(offset) == pytest.approx(range_m, rel=1e-12)
    np.testing.assert_allclose(frame.direction_cosines(offset), cosine, atol=1e-12)


@given(st.floats(0, 2 * np.pi), st.floats(0.01, 1.56), st.floats(1, 600))
def test_the_frames_are_what_the_angles_of_the_convention_say(theta, phi, range_m):
    sin_phi, cos_phi = np.sin(phi), np.cos(phi)
    offset = range_m * np.array([[sin_phi * np.cos(theta), -sin_phi * np.sin(theta), -cos_phi]])
    u, w = PaperFrame().direction_cosines(offset)
    np.testing.assert_allclose([u[0], w[0]], [np.cos(theta) * cos_phi, np.sin(theta) * cos_phi], atol=1e-12)
    u, w = PanelFrame().direction_cosines(offset)
    np.testing.assert_allclose([u[0], w[0]], [sin_phi * np.cos(theta), cos_phi], atol=1e-12)


@given(FRAMES, st.floats(0, 2 * np.pi), st.floats(1.0001, 10))
def test_directions_outside_the_visible_region_have_no_offset(frame, angle, radius):
    offset = frame.offsets([10.0], [radius * np.cos(angle)], [radius * np.sin(angle)])
    assert np.isnan(offset).any(axis=1).all()


@given(FRAMES, cosines(), st.floats(0.1, 600))
def test_the_jacobian_is_the_slope_of_the_offsets(frame, cosine, range_m):
    # Off the singular places, where slopes grow and a difference needs ever smaller steps.
    assume(0.05 < np.hypot(*cosine)[0] < 0.99)
    place, steps = np.array([[range_m], *cosine]), 1e-5 * np.eye(3)[:, :, None]
    slopes = [(frame.offsets(*place + step) - frame.offsets(*place - step)) / 2e-5 for step in steps]
    jacobian = frame.offset_jacobian(*place)
    assert jacobian.shape == (1, 3, 3)
    np.testing.assert_allclose(jacobian, np.stack(slopes, -1), rtol=1e-6, atol=1e-5 * max(range_m, 1))


@given(PANELS, st.tuples(st.floats(0.1, 2), st.floats(0.1, 2)), cosines(), st.floats(0.1, 600))
def test_other_spacings_scale_the_cosines_and_nothing_else(frame, spacing, cosine, range_m):
    spaced = PanelFrame(frame.yaw_deg, frame.tilt_deg, spacing)
    scale = 2 * np.array(spacing)
    scaled = [factor * each for factor, each in zip(scale, cosine, strict=True)]
    assume(0.05 < np.hypot(*cosine)[0] < 0.99)
    offset = frame.offsets([range_m], *cosine)
    np.testing.assert_allclose(spaced.direction_cosines(offset), scaled, atol=1e-12)
    np.testing.assert_allclose(spaced.offsets([range_m], *scaled), offset, atol=1e-9)
    expected = frame.offset_jacobian([range_m], *cosine) / np.array([1, *scale])
    np.testing.assert_allclose(spaced.offset_jacobian([range_m], *scaled), expected, rtol=1e-9, atol=1e-9)
    assert spaced.visible(*scaled).all()
    assert not spaced.visible(*(each / np.hypot(*cosine) * 1.01 for each in scaled)).any()


@pytest.mark.parametrize(
    ("spacing", "text"),
    [((0.5, 0.5), ""), ((0.4, 0.8), "14.5° along w"), ((1.0, 2.0), "0.0° along u, 0.0° along w")],
)
def test_ambiguity_begins_where_a_grating_lobe_comes_into_sight(spacing, text):
    assert PanelFrame(spacing_wavelengths=spacing).ambiguity == text
    if spacing[1] == 0.8:
        # Two directions whose phases from element to element differ by a whole turn.
        seen = PanelFrame(spacing_wavelengths=spacing).cosine_scale[1] * np.sin(np.radians(14.5))
        assert -spacing[1] * 2 == pytest.approx(seen - 2, abs=2e-2)


@pytest.mark.parametrize("spacing", [(0.09, 0.5), (0.5, 2.1)])
def test_spacings_that_no_array_has_are_refused(spacing):
    with pytest.raises(InputError, match=r"spacing_wavelengths = .*: allowed is a number from 0.1 to 2"):
        PanelFrame(spacing_wavelengths=spacing)


def test_the_papers_frame_has_half_wavelengths():
    with pytest.raises(InputError, match="spacing_wavelengths is that of a panel"):
        get_frame("paper", spacing_wavelengths=(0.5, 0.8))


def test_where_a_frame_is_singular_or_blind_there_is_no_jacobian():
    for frame, u, w in (
        *((PaperFrame(), 0.0, 0.0), (PaperFrame(), 1.0, 0.0), (PaperFrame(), 0.8, 0.8)),
        *((PanelFrame(), 0.0, -1.0), (PanelFrame(), 0.8, 0.8)),
    ):
        assert np.isnan(frame.offset_jacobian([10.0], [u], [w])).any(), (frame, u, w)


@given(st.floats(0, 2 * np.pi))
def test_straight_down_is_seen_in_the_paper_frame_whatever_the_rounding(angle):
    offset = PaperFrame().offsets([10.0], [np.cos(angle)], [np.sin(angle)])
    np.testing.assert_allclose(offset, [[0.0, 0.0, -10.0]], atol=1e-6)


@pytest.mark.parametrize("zero", [0.0, -0.0])
def test_the_horizon_of_the_paper_frame_is_singular_and_taken_at_zero_azimuth(zero):
    u, w = PaperFrame().direction_cosines([[-3.0, -4.0, 0.0], [3.0, -4.0, 0.0]])
    np.testing.assert_array_equal([u, w], np.zeros((2, 2)))
    np.testing.assert_allclose(PaperFrame().offsets([5.0], [zero], [zero]), [[5.0, 0.0, 0.0]], atol=1e-12)


def test_the_paper_frame_sees_what_is_not_above_the_base_station():
    assert PaperFrame().in_half_space([[1, 1, -1], [1, 1, 0], [1, 1, 1]]).tolist() == [True, True, False]


def test_the_panel_faces_the_street_unless_turned():
    ahead, behind = [[3, -5, 8]], [[3, 5, 8]]
    assert PanelFrame().in_half_space(ahead).all()
    assert not PanelFrame().in_half_space(behind).any()
    assert PanelFrame(yaw_deg=180).in_half_space(behind).all()
    assert PanelFrame(tilt_deg=90).in_half_space([[3, 5, -8]]).all()


@given(PANELS)
def test_the_axes_of_a_panel_are_orthonormal(panel):
    np.testing.assert_allclose(panel.axes @ panel.axes.T, np.eye(3), atol=1e-15)


def test_yaw_turns_counter_clockwise_from_above_and_tilt_downwards():
    """Axes along u, along w, and the normal."""
    for panel, axes in (
        (PanelFrame(0, 0), [[1, 0, 0], [0, 0, -1], [0, -1, 0]]),
        (PanelFrame(90, 0), [[0, 1, 0], [0, 0, -1], [1, 0, 0]]),
        (PanelFrame(0, 90), [[1, 0, 0], [0, 1, 0], [0, 0, -1]]),
    ):
        np.testing.assert_allclose(panel.axes, axes, atol=1e-15)


def test_only_a_panel_can_be_turned():
    assert get_frame("panel", yaw_deg=3.0, tilt_deg=4.0) == PanelFrame(3.0, 4.0)
    assert get_frame("paper") == PaperFrame()
    with pytest.raises(InputError, match="yaw_deg and tilt_deg turn a panel; the frame 'paper' has neither"):
        get_frame("paper", tilt_deg=1.0)
