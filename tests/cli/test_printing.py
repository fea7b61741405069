import pandas as pd
import pytest

from isacbench.cli.printing import report_run
from isacbench.report.table_texts import Grid


@pytest.fixture(autouse=True)
def _without_files(monkeypatch):
    for name in ("tables.tables_by_kind.write_run_tables", "html.guarded_pages.draw_run_and_page"):
        monkeypatch.setattr(f"isacbench.report.{name}", lambda *_: [])


def shown_of(records, grids, folder, monkeypatch, capsys):
    monkeypatch.setattr("isacbench.report.run_tables.tables_of", lambda *_: grids)
    report_run(folder, records, "population")
    return capsys.readouterr().out


def test_details_are_written_and_not_printed(tmp_path, monkeypatch, capsys):
    grids = [Grid("what all need", ["name"], [["first"]]), Grid("the rest", ["name"], [["second"]], (), True)]
    shown = shown_of(pd.DataFrame(), grids, tmp_path, monkeypatch, capsys)
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
def test_cells_that_have_scores_but_no_gospa_are_told(records, told, tmp_path, monkeypatch, capsys):
    shown = shown_of(pd.DataFrame(records), [], tmp_path, monkeypatch, capsys)
    assert told in shown
    assert ("gospa" in shown) == bool(told)
