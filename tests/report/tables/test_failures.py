import json

import pandas as pd

from isacbench.report.run_tables import failure_tables
from isacbench.report.table_texts import markdown


def records_of(*reasons, **columns):
    rows = {
        "scenario": "street",
        "estimator": "a",
        "params": json.dumps({}),
        "snr_db": 0.0,
        "trial": 0,
        "status": "error",
        "reason": reasons,
    }
    return pd.DataFrame({**rows, **columns})


def test_without_failures_there_is_no_table():
    assert failure_tables(records_of("", "", status=["ok", "no_detection"])) == []


def test_reasons_are_counted_by_estimator_and_scenario_the_most_frequent_first():
    records = records_of(
        "no luck", "more than 10 s", "no luck", "", status=["error", "timeout", "error", "ok"]
    )
    (grid,) = failure_tables(pd.concat([records, records.assign(estimator="b"), records]))
    assert grid.title == "9 of 12 cells failed"
    assert grid.rows == [
        ["no luck", "error", "a", "street", "4"],
        ["more than 10 s", "timeout", "a", "street", "2"],
        ["no luck", "error", "b", "street", "2"],
        ["more than 10 s", "timeout", "b", "street", "1"],
    ]


def test_scenes_of_one_template_share_a_row():
    scenes = records_of("no luck", "no luck", "lost", scenario=["room-u-1", "room-u-2", "user-awgn"])
    (grid,) = failure_tables(scenes.assign(template=["room", "room", ""]))
    assert [(row[3], row[4]) for row in grid.rows] == [("room", "2"), ("user-awgn", "1")]


def test_the_table_is_bounded_and_its_text_cannot_leave_its_cell():
    (grid,) = failure_tables(records_of("x" * 10_000 + "\x1b[31m|<script>", *map(str, range(99))))
    assert len(grid.rows) == 21
    assert grid.rows[-1] == ["80 further rows", "", "", "", "80"]
    text = markdown(grid)
    assert len(text) < 2500
    assert "\x1b" not in text
    assert r"\|&lt;script>" in text
