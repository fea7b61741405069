"""Pages of a notebook: a table, and a picture that shows what the object holds."""

import base64
import dataclasses
import re

import matplotlib
import numpy as np
import pytest

from isacbench.model.cloud import PointCloud
from isacbench.model.echo import observe_echo
from isacbench.model.scene import Scatterers
from isacbench.model.scenes.scenario import load_scenario
from isacbench.plugins.contracts import Detection
from isacbench.report.texts.notebook import MOST_POINTS, draw

CLOUD = PointCloud([[1, 2, 3], [4, 5, 6], [7, 8, 10]], [-10, 0, 10], [1, 1, 1])
MOST_BYTES = 60_000


@pytest.fixture(scope="module")
def lone():
    """A scenario of one scatterer."""
    scatterers = Scatterers([[20.0, 5.0, 15.0]], [9.0], [1.0])
    return dataclasses.replace(load_scenario("single"), scatterers=scatterers)


@pytest.fixture(scope="module")
def single(lone):
    return observe_echo(lone, snr_db=0)


def png_of(shown):
    (text,) = re.findall(r'<img alt="[^"]+" src="data:image/png;base64,([^"]+)">', shown._repr_html_())
    return base64.b64decode(text)


def test_clouds_and_maps_have_a_small_picture_and_a_table(single):
    detection = Detection(np.eye(5, dtype=bool), np.ones((5, 5)), np.ones((5, 5)))
    for shown in (CLOUD, single, detection):
        png = png_of(shown)
        assert png.startswith(b"\x89PNG")
        assert len(png) < MOST_BYTES
        assert "<table><tr><th" in shown._repr_html_()


def test_what_holds_nothing_to_draw_has_no_picture(single):
    silent = dataclasses.replace(single, cells=np.zeros_like(single.cells))
    broken = dataclasses.replace(single, cells=np.full_like(single.cells, np.nan))
    for shown in (PointCloud.empty(), silent, broken, single.gate, load_scenario("single")):
        assert "<img" not in shown._repr_html_()


def test_a_cloud_is_seen_from_above_and_from_the_side_in_the_colours_of_its_velocities():
    above, side, _ = draw(CLOUD).axes
    for axes, up in ((above, 1), (side, 2)):
        (points,) = axes.collections
        np.testing.assert_allclose(points.get_offsets(), CLOUD.xyz[:, [0, up]])
        assert len(np.unique(points.get_facecolors(), axis=0)) == 3
        assert axes.get_aspect() == 1


def test_of_many_points_some_are_drawn_and_the_picture_says_so():
    n = 3 * MOST_POINTS
    figure = draw(PointCloud(np.arange(3.0 * n).reshape(n, 3), np.zeros(n), np.ones(n)))
    assert len(figure.axes[0].collections[0].get_offsets()) == MOST_POINTS
    assert figure.axes[0].get_title() == "from above, one point in 3"


def test_the_map_of_an_observation_peaks_where_the_scatterer_is(lone, single):
    axes = draw(single).axes[0]
    (image,) = axes.images
    left, right, lower, upper = image.get_extent()
    values = image.get_array()
    row, column = np.unravel_index(values.argmax(), values.shape)
    range_m = lower + (row + 0.5) * (upper - lower) / values.shape[0]
    velocity_mps = left + (column + 0.5) * (right - left) / values.shape[1]
    assert range_m == pytest.approx(lone.range_m[0], abs=lone.system.range_bin_m)
    assert velocity_mps == pytest.approx(9.0, abs=lone.system.velocity_bin_mps)


def test_detected_cells_are_dots_on_their_thresholds():
    mask = np.zeros((4, 6), dtype=bool)
    mask[1, 5] = mask[3, 0] = True
    axes = draw(Detection(mask, np.full((4, 6), 100.0), np.ones((4, 6)))).axes[0]
    np.testing.assert_allclose(axes.images[0].get_array(), 20.0)
    assert {tuple(place) for place in axes.collections[0].get_offsets()} == {(5.0, 1.0), (0.0, 3.0)}


def test_the_users_own_style_neither_changes_a_picture_nor_is_changed_by_it():
    plain = png_of(CLOUD)
    with matplotlib.rc_context({"font.size": 30, "axes.facecolor": "red"}):
        assert png_of(CLOUD) == plain
        assert matplotlib.rcParams["font.size"] == 30
