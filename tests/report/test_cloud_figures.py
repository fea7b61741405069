"""Pictures of clouds: in perspective, in projection, and as users call for them."""

import numpy as np
import pytest

from isacbench import InputError, PointCloud, load_scenario, plot_clouds
from isacbench.model.region import Region
from isacbench.report.clouds import Image, draw_clouds, draw_comparison, velocity_colours

REGION = Region((0.0, 30.0), (0.0, 20.0), (0.0, 20.0), (-15.0, 15.0))
EMPTY = PointCloud.empty()
TRUTH = PointCloud([[0, 0, 0], [10, 5, 2], [20, 18, 9]], [0, 10, -2], [1, 1, 1])
NEAR_AND_FALSE = PointCloud([[0.5, 0, 0], [20, 18, 9.9], [25, 3, 4]], [0, -2, 7], [1, 1, 1])


def perspectives_of(figure):
    return [axes for axes in figure.axes if axes.name == "3d"]


def projections_of(figure):
    return [axes for axes in figure.axes if axes.name != "3d" and axes.get_ylabel() in ("y [m]", "z [m]")]


def headings_of(figure):
    return [[text.get_text() for text in axes.texts] for axes in perspectives_of(figure)]


def grid(*clouds, truth=EMPTY, n_columns=4):
    return draw_clouds("", truth, REGION, 1.0, [("$a", Image(one, "note")) for one in clouds], n_columns)


def comparison(cloud, truth=TRUTH, radius_m=1.0):
    return draw_comparison("", truth, "estimate", Image(cloud, ""), REGION, radius_m)


def test_images_stand_in_rows_with_their_headings_and_notes():
    figure = grid(*[NEAR_AND_FALSE] * 5, n_columns=3)
    assert headings_of(figure) == [[r"\$a", "note"]] * 5
    assert perspectives_of(figure)[4].get_subplotspec().get_geometry()[:2] == (2, 3)


def test_all_perspectives_show_one_box_of_whole_metres_around_all_points_and_the_truth_in_it():
    for axes in perspectives_of(grid(NEAR_AND_FALSE, EMPTY, truth=TRUTH)):
        limits = np.transpose([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()])
        np.testing.assert_array_equal(limits, [[0, 0, 0], [25, 18, 10]])
        drawn = np.concatenate([np.transpose(points._offsets3d) for points in axes.collections])
        assert set(map(tuple, TRUTH.xyz)) <= set(map(tuple, drawn))


def test_all_directions_of_a_perspective_have_one_scale_even_in_a_flat_box():
    (axes,) = perspectives_of(grid(PointCloud([[0, 0, 0], [900, 0, 1]], [0, 0], [1, 1])))
    size_m = np.ptp([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()], axis=1)
    np.testing.assert_array_equal(size_m, [900, 90, 90])
    np.testing.assert_allclose(axes._box_aspect / axes._box_aspect[0], size_m / size_m[0])


def test_projections_show_misses_as_open_circles_and_false_points_as_crosses():
    planes = projections_of(comparison(NEAR_AND_FALSE))
    names = [axes.get_xlabel() + axes.get_ylabel() for axes in planes]
    assert names == ["x [m]y [m]", "x [m]z [m]", "y [m]z [m]"]
    truth, right, false = planes[1].collections
    np.testing.assert_array_equal(truth.get_offsets(), TRUTH.xyz[:, [0, 2]])
    assert not len(truth.get_facecolors())
    np.testing.assert_array_equal(right.get_offsets(), NEAR_AND_FALSE.xyz[:2, [0, 2]])
    np.testing.assert_array_equal(false.get_offsets(), NEAR_AND_FALSE.xyz[2:, [0, 2]])


@pytest.mark.parametrize(("radius_m", "n_false"), [(0.25, 3), (0.75, 2), (1.0, 1), (20.0, 0)])
def test_the_radius_decides_what_is_marked_and_the_legend_names_it(radius_m, n_false):
    figure = comparison(NEAR_AND_FALSE, radius_m=radius_m)
    assert len(projections_of(figure)[0].collections[2].get_offsets()) == n_false
    entry = figure.legends[0].get_texts()[-1].get_text()
    assert entry == f"false point: farther than {radius_m:g} m from the truth"


def test_points_are_coloured_by_their_velocity():
    points = projections_of(comparison(TRUTH))[0].collections[1]
    still, approaching, receding = points.get_facecolors()[:, [0, 2]]
    assert np.ptp(still) < 0.05
    assert approaching[0] > approaching[1]
    assert receding[0] < receding[1]


@pytest.mark.parametrize("xyz", [[[3.0, 4.0, 5.0]], [[0.0, 0.0, 0.0], [900.0, 0.0, 1.0]]])
def test_a_point_and_a_line_of_points_have_axes_with_few_ticks(xyz):
    cloud = PointCloud(xyz, np.zeros(len(xyz)), np.ones(len(xyz)))
    figure = comparison(cloud, cloud)
    figure.draw_without_rendering()
    assert all(len(axes.get_xticks()) <= 12 for axes in figure.axes)
    assert all(len(axes.get_zticks()) <= 8 for axes in perspectives_of(figure))


def test_the_suffix_of_a_picture_decides_its_format(tmp_path):
    pictures = ((TRUTH, "a.png", b"\x89PNG"), (None, "a.PDF", b"%PDF"), (None, "a.svg", b"<?xml"))
    for truth, name, magic in pictures:
        plot_clouds(truth, TRUTH, title="title of $1", out=str(tmp_path / name))
        assert (tmp_path / name).read_bytes().startswith(magic), name


@pytest.mark.parametrize("truth", [None, EMPTY])
def test_without_truth_nothing_is_marked_or_explained(truth):
    figure = plot_clouds(truth, NEAR_AND_FALSE)
    assert headings_of(figure) == [["estimate", "3 points"]]
    _, right, false = perspectives_of(figure)[0].collections
    assert (len(right._offsets3d[0]), len(false._offsets3d[0])) == (3, 0)
    assert not figure.legends


def test_several_estimates_stand_beside_the_truth_and_may_be_called_truth_too():
    figure = plot_clouds(TRUTH, {"truth": TRUTH, "b": EMPTY})
    assert headings_of(figure) == [["truth", "3 scatterers"], ["truth", "3 points"], ["b", "no points"]]
    assert len(figure.legends) == 1


def test_empty_clouds_show_the_region_where_one_is_given(tiny):
    region = load_scenario(tiny).region
    assert perspectives_of(plot_clouds(None, EMPTY, region=region))[0].get_xlim() == tuple(region.x_m)
    assert perspectives_of(plot_clouds(None, EMPTY))[0].get_xlim() == (0, 2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"estimate": np.zeros((3, 4))}, r"'estimate': allowed is a PointCloud, not ndarray; PointCloud\.fr"),
        ({"estimate": {}}, r"estimate: a mapping without clouds; allowed is at least one"),
        ({"truth": [[0, 0, 0, 1]]}, r"truth: allowed is a PointCloud, not list"),
        ({"radius_m": float("nan")}, r"radius_m = nan: allowed is a positive, finite number of m"),
        ({"out": "picture.jpg"}, r"picture\.jpg: a picture takes the extension \.png, \.pdf or \.svg"),
        ({"truth": None, "out": "nowhere/picture.png"}, r"picture\.png: cannot be written: No such file"),
    ],
)
def test_a_mistake_is_one_clear_message(tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=message):
        plot_clouds(**{"truth": TRUTH, "estimate": TRUTH, **arguments})


@pytest.mark.parametrize("truth", [None, TRUTH])
def test_points_without_velocities_have_one_colour_and_no_scale(truth):
    points = PointCloud(TRUTH.xyz)
    figure = plot_clouds(truth, {"a": points} if truth is None else points)
    (*_, panel) = perspectives_of(figure)
    colours = {tuple(row[:3]) for row in panel.collections[-2].get_facecolor()}
    assert len(colours) == 1
    has_scale = any("radial velocity" in axes.get_ylabel() for axes in figure.axes)
    assert has_scale == (truth is not None)


def test_velocity_colours_are_centred_at_zero_and_span_both_directions():
    norm = velocity_colours(15.0).norm
    assert norm(0.0) == pytest.approx(0.5)
    assert (norm.vmin, norm.vmax) == (-15.0, 15.0)
    assert norm(2.0) - 0.5 > 2 * 2 / 30
    assert velocity_colours(0.0).norm.vmax > 0
