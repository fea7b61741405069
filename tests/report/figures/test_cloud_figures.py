import numpy as np
import pytest

from isacbench.model.cloud import PointCloud
from isacbench.model.region import Region
from isacbench.report.clouds import Image, draw_clouds, draw_comparison, draw_images

REGION = Region((0.0, 30.0), (0.0, 20.0), (0.0, 20.0), (-15.0, 15.0))
TRUTH = PointCloud([[0, 0, 0], [10, 5, 2], [20, 18, 9]], [0, 10, -2], [1, 1, 1])
NEAR_AND_FALSE = PointCloud([[0.5, 0, 0], [20, 18, 9.9], [25, 3, 4]], [0, -2, 7], [1, 1, 1])


def perspectives_of(figure):
    return [axes for axes in figure.axes if axes.name == "3d"]


def projections_of(figure):
    return [axes for axes in figure.axes if axes.name != "3d" and axes.get_ylabel() in ("y [m]", "z [m]")]


def texts_of(figure):
    return {text.get_text() for text in figure.texts} | {
        text.get_text() for axes in figure.axes for text in axes.texts
    }


def test_clouds_stand_in_a_grid_of_estimators_and_snrs_beside_the_truth():
    images = [Image(NEAR_AND_FALSE, "3 points"), Image(PointCloud.empty(), "nothing detected")]
    figure = draw_clouds("title", TRUTH, REGION, ["a", "b"], {-20.0: images, 10.0: images}, 1.0)
    assert len(perspectives_of(figure)) == 2 * 3
    wanted = {"truth", "a", "b", "SNR -20 dB", "SNR 10 dB", "3 scatterers", "3 points", "nothing detected"}
    assert wanted <= texts_of(figure)


def test_all_perspectives_show_one_box_of_whole_metres_around_all_points():
    figure = draw_clouds("", TRUTH, REGION, ["a"], {0.0: [Image(NEAR_AND_FALSE, "")]}, 1.0)
    for axes in perspectives_of(figure):
        limits = np.transpose([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()])
        np.testing.assert_array_equal(limits, [[0, 0, 0], [25, 18, 10]])
        drawn = np.concatenate([np.transpose(points._offsets3d) for points in axes.collections])
        assert set(map(tuple, TRUTH.xyz)) <= set(map(tuple, drawn))


def test_all_directions_of_a_perspective_have_one_scale_even_in_a_flat_box():
    line = PointCloud([[0, 0, 0], [900, 0, 1]], [0, 0], [1, 1])
    figure = draw_images("", PointCloud.empty(), {"a": Image(line, "")}, REGION, 1.0)
    (axes,) = perspectives_of(figure)
    size_m = np.ptp([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()], axis=1)
    np.testing.assert_array_equal(size_m, [900, 90, 90])
    np.testing.assert_allclose(axes._box_aspect / axes._box_aspect[0], size_m / size_m[0])


def test_projections_show_misses_as_open_circles_and_false_points_as_crosses():
    figure = draw_comparison("title", TRUTH, "estimate", Image(NEAR_AND_FALSE, "3 points"), REGION, 1.0)
    assert [axes.get_xlabel() + axes.get_ylabel() for axes in projections_of(figure)] == [
        "x [m]y [m]",
        "x [m]z [m]",
        "y [m]z [m]",
    ]
    truth, right, false = projections_of(figure)[1].collections
    np.testing.assert_array_equal(truth.get_offsets(), TRUTH.xyz[:, [0, 2]])
    assert not len(truth.get_facecolors())
    np.testing.assert_array_equal(right.get_offsets(), NEAR_AND_FALSE.xyz[:2, [0, 2]])
    np.testing.assert_array_equal(false.get_offsets(), NEAR_AND_FALSE.xyz[2:, [0, 2]])


def test_the_radius_decides_what_is_marked_and_the_legend_names_it():
    for radius_m, n_false in ((0.25, 3), (0.75, 2), (1.0, 1), (20.0, 0)):
        figure = draw_comparison("", TRUTH, "estimate", Image(NEAR_AND_FALSE, ""), REGION, radius_m)
        assert len(projections_of(figure)[0].collections[2].get_offsets()) == n_false
        assert [text.get_text() for text in figure.legends[0].get_texts()][-1] == (
            f"false point: farther than {radius_m:g} m from the truth"
        )


def test_without_truth_one_panel_shows_the_estimate_and_nothing_is_marked_or_explained():
    figure = draw_images("title", PointCloud.empty(), {"a": Image(NEAR_AND_FALSE, "3 points")}, REGION, 1.0)
    (panel,) = perspectives_of(figure)
    assert not projections_of(figure)
    assert not figure.legends
    assert {"a", "3 points"} <= texts_of(figure)
    assert not any("truth" in text or "scatterer" in text for text in texts_of(figure))
    _, right, false = panel.collections
    assert len(right._offsets3d[0]) == 3
    assert not len(false._offsets3d[0])


def test_several_images_stand_after_the_truth_and_an_image_may_be_called_truth_too():
    images = {name: Image(NEAR_AND_FALSE, name) for name in ("truth", "b", "c", "d")}
    figure = draw_images("", TRUTH, images, REGION, 1.0)
    assert len(perspectives_of(figure)) == 5
    headings = [axes.texts[0].get_text() for axes in perspectives_of(figure)]
    assert headings == ["truth", "truth", "b", "c", "d"]
    assert "false point: farther than 1 m from the truth" in [
        text.get_text() for text in figure.legends[0].get_texts()
    ]


def test_points_are_coloured_by_their_velocity():
    figure = draw_comparison("title", TRUTH, "estimate", Image(TRUTH, ""), REGION, 1.0)
    still, approaching, receding = projections_of(figure)[0].collections[1].get_facecolors()[:, [0, 2]]
    assert np.ptp(still) < 0.05
    assert approaching[0] > approaching[1]
    assert receding[0] < receding[1]


@pytest.mark.parametrize("xyz", [[[3.0, 4.0, 5.0]], [[0.0, 0.0, 0.0], [900.0, 0.0, 1.0]]])
def test_a_point_and_a_line_of_points_have_axes_with_few_ticks(xyz):
    n = len(xyz)
    cloud = PointCloud(xyz, np.zeros(n), np.ones(n))
    figure = draw_comparison("", cloud, "estimate", Image(cloud, ""), REGION, 1.0)
    figure.draw_without_rendering()
    assert all(len(axes.get_xticks()) <= 12 for axes in figure.axes)
    assert all(len(axes.get_zticks()) <= 8 for axes in perspectives_of(figure))
