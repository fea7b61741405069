"""Tables of a run: those of its kind, of its times and of its failures, printed and written."""

import json

import numpy as np
import pandas as pd
import pytest

from isacbench.bench.cells.rows import COLUMNS, TIMING_COLUMNS, typed
from isacbench.bench.kinds.imaging import ImagingKind
from isacbench.bench.run_times import stage_tables, summarise_stages
from isacbench.bench.store.run import Run
from isacbench.bench.suites.suite_kinds import KINDS
from isacbench.report.run_report import failure_tables, write_run_tables
from isacbench.report.tables import markdown


def rows_of(*reasons, **columns):
    row = {"scenario": "street", "estimator": "a", "params": "{}", "snr_db": 0.0, "trial": 0}
    return pd.DataFrame({**row, "status": "error", "reason": reasons, **columns})


def test_without_failures_there_is_no_table():
    assert failure_tables(rows_of("", "", status=["ok", "no_detection"])) == []


def test_reasons_are_counted_by_estimator_and_scenario_the_most_frequent_first():
    rows = rows_of("no luck", "more than 10 s", "no luck", "", status=["error", "timeout", "error", "ok"])
    (table,) = failure_tables(pd.concat([rows, rows.assign(estimator="b"), rows]))
    assert table.title == "9 of 12 cells failed"
    assert table.texts == [
        ["no luck", "error", "a", "street", "4"],
        ["more than 10 s", "timeout", "a", "street", "2"],
        ["no luck", "error", "b", "street", "2"],
        ["more than 10 s", "timeout", "b", "street", "1"],
    ]


def test_scenes_of_one_template_share_a_row():
    scenes = rows_of("no luck", "no luck", "lost", scenario=["room-u-1", "room-u-2", "user-awgn"])
    (table,) = failure_tables(scenes.assign(template=["room", "room", ""]))
    assert [(row[3], row[4]) for row in table.texts] == [("room", "2"), ("user-awgn", "1")]


def test_the_table_is_bounded_and_its_text_cannot_leave_its_cell():
    (table,) = failure_tables(rows_of("x" * 10_000 + "\x1b[31m|<script>", *map(str, range(99))))
    assert len(table.texts) == 21
    assert table.texts[-1] == ["80 further rows", "", "", "", "80"]
    text = markdown(table)
    assert len(text) < 2500
    assert "\x1b" not in text
    assert r"\|&lt;script>" in text


def made(folder, rows, kind="imaging"):
    """Run of made-up rows."""
    return Run(str(folder), rows, {"suite": {"kind": kind, "scenarios": []}, "scenarios": {}})


@pytest.fixture
def timed(made_run):
    """Rows of a made-up timed run."""
    rows, _ = made_run(("street", "yard"), ("blob", "nomp4d"), trials=3)
    names = [*(f"hausdorff_{what}_m" for what in ("xy", "xz", "yz", "sum")), "density", "velocity_nmse"]
    scores = dict.fromkeys([*names, "chamfer_m", "gospa_m", "precision"], 1.0)
    times = dict.fromkeys(TIMING_COLUMNS, 0.001)
    return rows.assign(timing=True, time_estimate_s=0.01, **scores, **times)


def test_tables_are_written_with_the_summary_and_the_failures_and_replaced(timed, tmp_path):
    timed["timing"] = False
    broken = timed["estimator"] == "nomp4d"
    timed.loc[broken, ["status", "reason", "deviation"]] = "error", "no luck", np.nan
    paths, shown = write_run_tables(made(tmp_path, timed))
    assert [path.name for path in paths] == ["summary.csv", "summary.md"]
    summary = pd.read_csv(paths[0])
    assert len(summary) == len(ImagingKind().summary(timed))
    assert summary["params"].map(json.loads).tolist() == [{}] * len(summary)
    lines = paths[1].read_text(encoding="utf-8").splitlines()
    assert [table.title for table in shown] == [table.title for table in ImagingKind().tables(timed)]
    titles = [table.title for table in [*shown, *failure_tables(timed)]]
    assert [line for line in lines if line.startswith("**")] == [f"**{title}**" for title in titles]
    assert "| no luck | error | nomp4d | street | 9 |" in lines
    assert write_run_tables(made(tmp_path, timed))[0] == paths


def test_tables_of_times_are_written_and_shown_beside_the_others_where_a_run_was_timed(timed, tmp_path):
    paths, shown = write_run_tables(made(tmp_path, timed))
    names = ["summary.csv", "summary.md", "stages.csv", "stages.md", "pareto.csv"]
    assert [path.name for path in paths] == names
    written = pd.read_csv(tmp_path / "stages.csv")
    pd.testing.assert_frame_equal(written, summarise_stages(timed).reset_index(drop=True))
    assert (tmp_path / "stages.md").read_text().count("**street: median processor time of an estimate") == 1
    titles = [table.title for table in ImagingKind().tables(timed) + stage_tables(timed)]
    assert [table.title for table in shown] == titles
    # They go where no row is timed any more.
    ordinary = timed.drop(columns=[*TIMING_COLUMNS]).assign(timing=False)
    paths, shown = write_run_tables(made(tmp_path, ordinary))
    assert [path.name for path in paths] == names[:2]
    assert sorted(path.name for path in tmp_path.iterdir()) == names[:2]
    assert len(shown) == 2


@pytest.mark.parametrize("kind", KINDS)
def test_a_run_that_was_interrupted_before_its_first_cell_has_no_tables(kind, tmp_path):
    columns = KINDS[kind].columns
    rows = typed(pd.DataFrame(columns=[*COLUMNS, *columns]), columns)
    assert write_run_tables(made(tmp_path, rows, kind)) == ([], [])
