import numpy as np
import pytest

from isacbench import InputError, PointCloud, load_scenario, plot_clouds

EMPTY = PointCloud.empty()
TRUTH = PointCloud([[0, 0, 0], [10, 5, 2]], [0, 10], [1, 1])


def perspectives_of(figure):
    return [axes for axes in figure.axes if axes.name == "3d"]


def test_the_suffix_of_a_picture_decides_its_format(tmp_path):
    pictures = ((TRUTH, "a.png", b"\x89PNG"), (None, "a.PDF", b"%PDF"), (None, "a.svg", b"<?xml"))
    for truth, name, magic in pictures:
        plot_clouds(truth, TRUTH, title="title of $1", out=str(tmp_path / name))
        assert (tmp_path / name).read_bytes().startswith(magic), name


@pytest.mark.parametrize("truth", [None, EMPTY])
def test_without_truth_each_estimate_has_a_panel_and_there_is_no_legend(truth):
    assert len(perspectives_of(plot_clouds(truth, TRUTH))) == 1
    figure = plot_clouds(truth, {"a": TRUTH, "b": EMPTY})
    assert len(perspectives_of(figure)) == 2
    assert not figure.legends


def test_several_estimates_stand_beside_the_truth():
    figure = plot_clouds(TRUTH, {"a": TRUTH, "b": EMPTY})
    assert [axes.texts[0].get_text() for axes in perspectives_of(figure)] == ["truth", "a", "b"]


def test_empty_clouds_show_the_region_where_one_is_given(tiny):
    region = load_scenario(tiny).region
    assert perspectives_of(plot_clouds(None, EMPTY, region=region))[0].get_xlim() == tuple(region.x_m)
    assert perspectives_of(plot_clouds(None, EMPTY))[0].get_xlim() == (0, 2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            {"estimate": np.zeros((3, 4))},
            r"estimate: allowed is a PointCloud, not ndarray; PointCloud\.from_array",
        ),
        ({"estimate": {"a": 1}}, r"estimate 'a': allowed is a PointCloud, not int"),
        ({"estimate": {}}, r"estimate: a mapping without clouds; allowed is at least one"),
        ({"truth": [[0, 0, 0, 1]]}, r"truth: allowed is a PointCloud, not list"),
        ({"radius_m": 0.0}, r"radius_m = 0\.0: allowed is a positive, finite number of m"),
        ({"radius_m": float("nan")}, r"radius_m = nan"),
        ({"out": "picture.jpg"}, r"picture\.jpg: a picture takes the extension \.png, \.pdf or \.svg"),
        ({"truth": None, "out": "nowhere/picture.png"}, r"picture\.png: cannot be written: No such file"),
    ],
)
def test_a_mistake_is_one_clear_message(tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=message):
        plot_clouds(**{"truth": TRUTH, "estimate": TRUTH, **arguments})


def test_points_without_velocities_have_one_colour_and_no_scale():
    points = PointCloud(TRUTH.xyz)
    for truth, estimate in ((None, points), (points, {"a": points}), (points, points)):
        figure = plot_clouds(truth, estimate)
        colours = [
            tuple(row) for axes in perspectives_of(figure) for row in axes.collections[-2].get_facecolor()
        ]
        assert len({colour[:3] for colour in colours}) == 1
        assert all(colour[3] > 0 for colour in colours)
        assert not any("radial velocity" in axes.get_ylabel() for axes in figure.axes)
    figure = plot_clouds(TRUTH, points)
    assert any("radial velocity" in axes.get_ylabel() for axes in figure.axes)
