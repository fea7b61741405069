from isacbench.cli.printing import report_run
from isacbench.report.tables.run_tables import Grid


def test_details_are_written_and_not_printed(tmp_path, monkeypatch, capsys):
    grids = [Grid("what all need", ["name"], [["first"]]), Grid("the rest", ["name"], [["second"]], (), True)]
    monkeypatch.setattr("isacbench.report.tables.tables_by_kind.grids_of", lambda *_: grids)
    monkeypatch.setattr("isacbench.report.tables.tables_by_kind.write_run_tables", lambda *_: [])
    monkeypatch.setattr("isacbench.report.html.guarded_pages.draw_run_and_page", lambda *_: [])
    report_run(tmp_path, None, "population")
    shown = capsys.readouterr().out
    assert "first" in shown
    assert "second" not in shown
