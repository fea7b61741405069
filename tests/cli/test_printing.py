from dataclasses import replace

import pandas as pd
import pytest

from isacbench.bench.store.run import Run
from isacbench.charts import text_table
from isacbench.cli.app import report_run


def shown_of(records, tables, monkeypatch, capsys):
    monkeypatch.setattr("isacbench.report.run_report.write_report", lambda *_: ([], tables))
    report_run(Run("run", records, {}))
    return capsys.readouterr().out


def test_details_are_written_and_not_printed(monkeypatch, capsys):
    first, second = (text_table(name, ["name"], [[name]]) for name in ("first", "second"))
    tables = [first, replace(second, is_detail=True)]
    shown = shown_of(pd.DataFrame(), tables, monkeypatch, capsys)
    assert "first" in shown
    assert "second" not in shown


@pytest.mark.parametrize(
    ("records", "told"),
    [
        ({"deviation": [1.0, 2.0, 3.0, None], "gospa_m": [1.0, None, None, None]}, "2 cells without gospa_m"),
        ({"deviation": [1.0, None], "gospa_m": [1.0, None]}, ""),
        ({"ber": [0.1]}, ""),
    ],
    ids=["scored but for gospa", "scored or failed", "of another kind"],
)
def test_cells_that_have_scores_but_no_gospa_are_told(records, told, monkeypatch, capsys):
    shown = shown_of(pd.DataFrame(records), [], monkeypatch, capsys)
    assert told in shown
    assert ("gospa" in shown) == bool(told)


@pytest.mark.parametrize("error", [PermissionError(13, "Permission denied", "a.toml"), KeyError("name")])
def test_an_error_that_nobody_expected_is_one_line_too(command_line, monkeypatch, error):
    def fail():
        raise error

    monkeypatch.setattr("isacbench.bench.suites.suite_kinds.catalogue", fail)
    result = command_line("list")
    assert (result.exit_code, result.stdout) == (2, "")
    hint = "(`python -X dev -m isacbench` shows where)"
    assert result.stderr == f"isacbench: {type(error).__name__}: {error} {hint}\n"
