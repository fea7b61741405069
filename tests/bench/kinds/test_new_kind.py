"""A kind of suite that one class declares is planned, run, stored, tabulated, drawn and compared."""

from typing import ClassVar

import pytest

from isacbench.bench.cells.task import ImagingTask, build_estimators
from isacbench.bench.compare.comparison import compare
from isacbench.bench.kinds.kind import NO_SCENARIOS, Kind, lines_of
from isacbench.bench.run.merging import merge
from isacbench.bench.run.rescoring import rescore
from isacbench.bench.run.runner import RunOptions, run_suite
from isacbench.bench.statistics import summarise
from isacbench.bench.store.run import Run
from isacbench.bench.suites.suite import Suite
from isacbench.bench.suites.suite_kinds import KINDS, load_suite
from isacbench.charts import Axis, Chart, ChartGroup, Column, Table, line_series
from isacbench.report.run_report import draw_run, write_run_tables


class CountSuite(Suite):
    """Suite with a key of its own."""

    kind: str = "count"
    offset: int = 0


class CountKind(Kind):
    """Number of points."""

    name = "count"
    suite = CountSuite
    columns: ClassVar = {"n_counted": 0}
    better: ClassVar = {"n_counted": "higher"}

    def tasks(self, suite, scenarios):
        def measure(image):
            return {"n_counted": len(image.cloud) + suite.offset}

        entries = build_estimators(suite)
        return [ImagingTask(suite, one, entries, measure=measure) for one in scenarios.values()]

    def summary(self, rows):
        keys = ["scenario", "estimator", "params", "snr_db"]
        return summarise(rows, keys, lambda part: {"n_counted": part["n_counted"].sum()})

    def tables(self, rows):
        columns = [Column("estimator", "estimator", part=0), Column("points", "n_counted")]
        return [Table("counts", columns, self.summary(rows))]

    def charts(self, rows, scenarios=NO_SCENARIOS):
        series = line_series(self.summary(rows), lines_of(rows), "snr_db", "n_counted")
        return [ChartGroup("counts", "title", [Chart("all", Axis("SNR [dB]"), Axis("points"), series)])]


@pytest.fixture
def suite(plugins, tiny, tmp_path, monkeypatch):
    monkeypatch.setitem(KINDS, CountKind.name, CountKind())
    path = tmp_path / "count.toml"
    path.write_text(
        'kind = "count"\nname = "c"\nscenarios = ["tiny.toml"]\nestimators = ["blob[n=3]"]\n'
        "snr_db = [0]\ntrials = 2\noffset = 4\n"
    )
    return load_suite(path)


def test_a_new_kind_is_run_stored_tabulated_and_drawn(suite, tmp_path):
    assert run_suite(suite, tmp_path / "run").rows["n_counted"].tolist() == [7, 7]
    stored = Run.open(tmp_path / "run")
    assert stored.suite == suite
    paths, (table,) = write_run_tables(stored)
    assert table.texts == [["blob", "14"]]
    assert [path.name for path in paths] == ["summary.csv", "summary.md"]
    assert [path.name for path in draw_run(stored)] == ["counts.png"]


def test_parts_of_a_new_kind_are_merged_scored_again_and_compared_in_its_direction(suite, tmp_path):
    suite, merged, less = suite.replace(trials=8), tmp_path / "merged", tmp_path / "less"
    for k in (1, 2):
        run_suite(suite, tmp_path / f"part{k}", options=RunOptions(shard=f"{k}/2"))
    assert merge([tmp_path / "part1", tmp_path / "part2"], merged).run.rows["n_counted"].tolist() == [7] * 8
    assert rescore(merged).changes == []
    run_suite(suite.replace(offset=0), less)
    assert compare(merged, less, tolerances="n_counted=5%").is_regression
    assert not compare(less, merged, tolerances="n_counted=5%").is_regression


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_a_kind_gives_directions_of_its_own_columns_alone(kind):
    assert {*kind.better} <= {*kind.columns}
