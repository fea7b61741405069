"""Pages as files: what is in them, and what can be joined in one."""

import base64
import hashlib
import itertools
import json
import re
import shutil
import zlib

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.bench.compare.comparison import compare
from isacbench.bench.compare.ranking import rank
from isacbench.bench.store.run import Run
from isacbench.errors import InputError
from isacbench.report.html.page_content import LEVELS, POWER_LEVELS, choose_clouds, pack_clouds
from isacbench.report.html.written_pages import (
    write_comparison_page,
    write_leaderboard,
    write_rank_page,
    write_run_page,
)

pytestmark = pytest.mark.first


def content_of(path):
    packed = re.search(r'id="content">([^<]*)<', path.read_text(encoding="utf-8"))[1]
    return json.loads(zlib.decompress(base64.b64decode(packed), 31))


def board(folders, path):
    """Write a leaderboard of stored runs."""
    return write_leaderboard([Run.open(folder) for folder in folders], path)


def page_of_comparison(*folders, **options):
    """Compare stored runs, and write the page."""
    runs = [Run.open(folder) for folder in folders]
    return write_comparison_page(compare(*runs, **options), runs)


def rewrite(path, change):
    """Change a table of a run as somebody else's program would write it, without a digest."""
    table = change(pd.read_parquet(path))
    table.attrs.clear()
    table.to_parquet(path)


def worsened(estimator):
    """Return a function that makes an estimator worse by 10, and by 50 in one cell."""

    def change(table):
        of_cell = (table["snr_db"] == 10) & (table["trial"] == 3)
        more = np.where(of_cell, 50.0, 10.0) * (table["estimator"] == estimator)
        return table.assign(deviation=table["deviation"] + more)

    return change


@pytest.fixture(scope="module")
def page(runs):
    """Path of the page of the run of images."""
    return write_run_page(Run.open(runs("images")))


def test_a_page_forbids_every_request_and_every_script_but_its_two(page):
    text = page.read_text(encoding="utf-8")
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)[1]
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == rules["base-uri"] == rules["form-action"] == "'none'"
    assert set(rules) == {"default-src", "script-src", "style-src", "img-src", "base-uri", "form-action"}
    own = re.search(r"<script>(.*?)</script>", text, re.DOTALL)[1]
    plotly = zlib.decompress(base64.b64decode(re.search(r'id="plotly">([^<]*)<', text)[1]), 31)
    digests = [base64.b64encode(hashlib.sha256(one).digest()).decode() for one in (own.encode(), plotly)]
    assert rules["script-src"].split() == [f"'sha256-{digest}'" for digest in digests]
    assert not re.search(r"https?://", text.replace("http://www.w3.org", ""))


def test_rows_of_a_page_are_those_of_the_run_and_one_scene_has_no_ranks(runs, page):
    content, records = content_of(page), Run.open(runs("images")).rows
    rows = content["rows"]
    names = [content["estimators"][one]["name"] for one in rows["estimator"]]
    assert names == list(records["estimator"])
    for column in ("snr_db", "trial", "deviation", "gospa_m", "recall"):
        np.testing.assert_allclose(np.array(rows[column], dtype=float), records[column], rtol=1e-5)
    assert [scene["name"] for scene in content["scenes"]] == ["yard"]
    objects = content["scenes"][0]["objects"]
    assert objects["levels"] == ["car 1", "pole 1"]
    assert len(objects["codes"]) == records["n_true"].iloc[0]
    assert "1 scene: six or more have ranks" in content["ranks"]["deviation"]["reason"]


def test_a_run_of_an_older_version_has_a_page_without_objects_and_keeps_all_digits_of_its_snrs(
    runs, tmp_path
):
    folder = shutil.copytree(runs("images"), tmp_path / "old")
    rewrite(folder / "truth.parquet", lambda table: table.drop(columns="objects"))
    for name in ("results.parquet", "clouds.parquet"):
        rewrite(folder / name, lambda table: table.assign(snr_db=table["snr_db"] + 1 / 3))
    content = content_of(write_run_page(Run.open(folder)))
    assert content["scenes"][0]["objects"] == {"codes": [], "levels": []}
    assert set(content["rows"]["snr_db"]) == {-10 + 1 / 3, 10 + 1 / 3}
    assert all(content["rows"]["has_image"])


def test_a_metric_that_is_not_installed_does_not_keep_a_run_from_its_page(runs, tmp_path):
    folder = shutil.copytree(runs("images"), tmp_path / "scored")
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["suite"]["metrics"] = ["height"]
    (folder / "manifest.json").write_text(json.dumps(manifest))
    content = content_of(write_run_page(Run.open(folder)))
    assert all(content["rows"]["has_image"])


def test_a_page_of_a_ranking_has_its_rank_sets(runs):
    found = content_of(write_rank_page(Run.open(runs("scenes")), "gospa_m"))
    wanted = rank(runs("scenes"), "gospa_m").ranks
    listed = found["ranks"]["gospa_m"]["ranks"]
    assert found["metric"] == "gospa_m"
    assert [row["rank_low"] for row in listed if not row["is_reference"]] == list(wanted["rank_low"].dropna())


def test_a_leaderboard_has_every_estimator_once_under_the_name_of_its_run_where_needed(runs, tmp_path):
    ours, same = runs("images"), shutil.copytree(runs("images"), tmp_path / "same")
    path = board([ours, same, runs("other")], tmp_path / "board.html")
    content = content_of(path)
    assert [one["label"] for one in content["estimators"]] == ["fft4d", "music2d", "oracle", "esprit2d"]
    assert content["notes"][:2] == [
        "fft4d of same has the same scores as that of images",
        "music2d of same has the same scores as that of images",
    ]
    rewrite(same / "results.parquet", worsened("fft4d"))
    content = content_of(board([ours, same], tmp_path / "board.html"))
    assert [one["label"] for one in content["estimators"]] == ["fft4d", "music2d", "oracle", "fft4d (same)"]
    assert [one["spec"] for one in content["estimators"]][-1] == "fft4d"
    assert [one["run"] for one in content["estimators"]] == [0, 0, 0, 1]


def test_a_leaderboard_is_over_the_cells_that_all_runs_have(runs, tmp_path):
    fewer = shutil.copytree(runs("other"), tmp_path / "fewer")
    rewrite(fewer / "results.parquet", lambda table: table[table["trial"] < 4])
    content = content_of(board([runs("images"), fewer], tmp_path / "board.html"))
    assert set(content["rows"]["trial"]) == set(range(4))
    assert "36 rows of images left out: not all runs have their SNR and trial" in content["notes"]


def test_an_estimator_without_common_cells_is_no_part_of_a_leaderboard(runs, tmp_path):
    early, late = (shutil.copytree(runs("images"), tmp_path / name) for name in ("early", "late"))
    for run, condition in (
        (early, "estimator != 'fft4d' or trial < 2"),
        (late, "estimator != 'fft4d' and trial > 4"),
    ):
        rewrite(run / "results.parquet", lambda table, condition=condition: table.query(condition))
    content = content_of(board([early, late], tmp_path / "board.html"))
    assert [one["label"] for one in content["estimators"]] == ["music2d", "oracle"]
    rewrite(early / "results.parquet", lambda table: table[table["trial"] < 2])
    with pytest.raises(InputError, match="no SNR and trial is in all of them"):
        board([early, late], tmp_path / "board.html")


def test_runs_of_other_scenes_have_no_common_page(runs, tmp_path):
    with pytest.raises(InputError, match="have no common page: only one of them has the scenes yard, yard0"):
        board([runs("images"), runs("scenes")], tmp_path / "board.html")
    with pytest.raises(InputError, match="given twice"):
        board([runs("images"), runs("images")], tmp_path / "board.html")


def test_a_comparison_shows_the_worst_verdict_first_with_both_images_where_it_is_worst(runs, tmp_path):
    worse = shutil.copytree(runs("images"), tmp_path / "worse")
    rewrite(worse / "results.parquet", worsened("music2d"))
    found = content_of(page_of_comparison(runs("images"), worse))
    first, compared = found["comparison"]["rows"][0], found["comparison"]
    assert compared["is_regression"]
    assert first["verdict"] == "regression"
    assert {row["what"] for row in compared["rows"]} == {"curve", "point"}
    assert first["worst"] == {"scene": "yard", "snr_db": 10.0, "trial": 3}
    labels = [one["label"] for one in found["estimators"]]
    assert [labels[first["base"]], labels[first["new"]]] == ["music2d (images)", "music2d (worse)"]
    assert all(found["rows"]["has_image"])


def test_a_comparison_of_two_estimators_of_one_run_has_a_page_of_its_own(runs):
    folder = runs("images")
    path = page_of_comparison(folder, between=("fft4d", "music2d"))
    assert path.name == "between.html"
    content = content_of(path)
    row = content["comparison"]["rows"][0]
    assert [content["estimators"][row[side]]["label"] for side in ("base", "new")] == ["fft4d", "music2d"]


def test_a_reference_without_clouds_is_compared_with_the_truth_of_the_other_run(runs, tmp_path):
    bare = shutil.copytree(runs("images"), tmp_path / "bare")
    for name in ("clouds.parquet", "truth.parquet"):
        (bare / name).unlink()
    content = content_of(page_of_comparison(bare, runs("images")))
    has_image = np.array(content["rows"]["has_image"])
    of_run = np.array([content["estimators"][one]["run"] for one in content["rows"]["estimator"]])
    assert not has_image[of_run == 0].any()
    assert has_image[of_run == 1].all()
    assert content["scenes"][0]["truth"]


def test_every_kind_of_run_has_a_page_with_its_own_charts(runs):
    link = content_of(write_run_page(Run.open(runs("link"))))
    assert {chart["y"]["title"] for chart in link["charts"]} == {"bit error rate", "imaging deviation"}
    detection = content_of(write_run_page(Run.open(runs("detection"))))
    rates = next(
        chart for chart in detection["charts"] if chart["y"]["title"] == "probability of false alarm"
    )
    assert rates["lines"] == [1e-3]
    assert [series["label"] for series in rates["series"]] == ["ca", "os"]
    for one in rates["series"]:
        assert all(np.diff([one["low"], one["y"], one["high"]], axis=0).ravel() >= 0)
    timed = content_of(write_run_page(Run.open(runs("timed-once"))))
    assert {point["label"] for point in timed["times"]["points"]} == {"fft4d", "oracle"}
    assert timed["times"]["stages"]


def test_names_of_a_run_do_not_reach_the_markup_of_its_page(runs, showing):
    text = write_run_page(Run.open(runs("hostile"))).read_text(encoding="utf-8")
    assert "alert" not in text.split("<script>")[0]
    content = content_of(runs("hostile") / "report.html")
    assert content["scenes"][0]["name"].startswith("<script>alert")


# Clouds: unpacked, they are what was packed, and the most wanted ones are chosen

places = st.floats(-1e4, 1e4, allow_nan=False, width=32)
point = st.tuples(places, places, places, st.floats(-50, 50), st.floats(1e-12, 1e12))
clouds = st.lists(st.lists(point, max_size=6), min_size=1, max_size=5)


def unpacked(content, counts):
    """Clouds as the script of a page reads them: x, y, z, v, power in dB."""
    n = int(np.sum(counts))
    limits = np.frombuffer(content, "<f4", 10 * len(counts)).reshape(-1, 5, 2).astype(float)
    planes = np.frombuffer(content, np.uint8, offset=40 * len(counts)).reshape(9, n).astype(float)
    steps = [256 * planes[2 * axis] + planes[2 * axis + 1] for axis in range(4)] + [planes[8]]
    own = np.repeat(limits, counts, axis=0)
    return np.stack([own[:, axis, 0] + own[:, axis, 1] * steps[axis] for axis in range(5)], axis=1)


@given(clouds)
def test_a_cloud_comes_back_within_half_a_step_of_its_own_extent(listed):
    counts = np.array([len(cloud) for cloud in listed])
    points = np.array([point for cloud in listed for point in cloud], dtype=float).reshape(-1, 5)
    found = unpacked(pack_clouds(points, counts), counts)
    wanted = points.copy()
    wanted[:, 4] = 10 * np.log10(points[:, 4])
    of_cloud = np.repeat(np.arange(len(counts)), counts)
    for number in range(len(counts)):
        own, other = wanted[of_cloud == number], found[of_cloud == number]
        if len(own):
            step = np.ptp(own, axis=0) / [LEVELS, LEVELS, LEVELS, LEVELS, POWER_LEVELS]
            rounding = 3e-7 * np.abs(own).max(axis=0)  # limits are stored in single precision
            assert np.all(np.abs(own - other) <= 0.51 * step + rounding + 1e-9)


def test_a_point_without_power_is_the_weakest_and_not_infinite():
    points = np.array([[0.0, 0, 0, 0, 0], [1, 1, 1, 1, 1]])
    assert np.isfinite(unpacked(pack_clouds(points, np.array([2])), [2])).all()


def rows(n_trials=3, snrs_db=(0.0, 11.0), scenarios=("a", "b")):
    cells = list(itertools.product(scenarios, snrs_db, range(n_trials)))
    table = pd.DataFrame(cells, columns=["scenario", "snr_db", "trial"])
    return table.assign(estimator="one", params="{}", deviation=10.0 * table["trial"] + table["snr_db"])


def test_a_page_holds_all_clouds_that_fit_and_of_too_many_what_is_looked_at_first():
    table = rows()
    n_points, key = np.full(len(table), 5), ["scenario", "snr_db", "trial"]

    def held(n_clouds, first=None):
        chosen = choose_clouds(table, n_points, first, most_points=5 * n_clouds)
        return {tuple(row) for row in table.loc[chosen, key].itertuples(index=False)}

    assert held(2) == {("a", 11.0, 0), ("b", 11.0, 0)}
    assert held(4) - held(2) == {("a", 11.0, 2), ("b", 11.0, 2)}  # of largest deviation
    assert held(6) - held(4) == {("a", 0.0, 0), ("b", 0.0, 0)}
    wanted = ((table["scenario"] == "b") & (table["trial"] == 1)).to_numpy()
    assert held(2, wanted) == {("b", 0.0, 1), ("b", 11.0, 1)}
    assert len(held(len(table))) == len(table)


def test_a_cell_that_failed_is_never_the_one_of_largest_deviation():
    table = rows().assign(deviation=np.nan)
    assert choose_clouds(table, np.full(len(table), 5), most_points=20).sum() == 4
