"""A kind of suite that one object declares is planned, run, stored, tabulated, drawn and compared."""

import sys
from pkgutil import resolve_name

import pytest
from isacbench.bench.suites.kind import Kind, Tables
from isacbench.report.tables.run_tables import Grid
from isacbench.report.tables.tables_by_kind import grids_of, write_run_tables

from isacbench.bench.compare.comparison import compare
from isacbench.bench.kinds.scenes import ImagedScene, build_estimators
from isacbench.bench.plan.run_plan import Shard
from isacbench.bench.run.merging import merge
from isacbench.bench.run.rescoring import rescore
from isacbench.bench.run.runner import Execution, run_suite
from isacbench.bench.statistics import summarise
from isacbench.bench.store.run import Run
from isacbench.bench.suites.suite import Suite
from isacbench.bench.suites.suite_kinds import KINDS, load_suite
from isacbench.report.drawing.style import new_figure
from isacbench.report.figures.run_figures import draw_run

KEY = ["scenario", "estimator", "params"]


class CountSuite(Suite):
    """Suite with a key of its own."""

    kind: str = "count"
    offset: int = 0


def count_scenes(suite, scenarios):
    def measure(shot):
        return {"n_counted": len(shot.cloud) + suite.offset}

    entries = build_estimators(suite)
    return [ImagedScene(suite, one, entries, suite.snr_db, measure=measure) for one in scenarios.values()]


def summarise_counts(records):
    return summarise(records, KEY, lambda part: {"n_counted": part["n_counted"].sum()})


def count_grids(records):
    summary = summarise_counts(records)
    return [
        Grid(
            "counts", ["estimator", "points"], summary[["estimator", "n_counted"]].astype(str).values.tolist()
        )
    ]


def count_figures(results):
    figure = new_figure(3, 3)
    figure.subplots().plot(results.rows["n_counted"])
    yield "counts", figure


COUNT = Kind(
    name="count",
    suite=CountSuite,
    columns={"n_counted": 0},
    better={"n_counted": "higher"},
    plan=f"{__name__}:count_scenes",
    tables=Tables(f"{__name__}:summarise_counts", f"{__name__}:count_grids"),
    figures=f"{__name__}:count_figures",
)


@pytest.fixture
def suite(plugins, tiny, tmp_path, monkeypatch):
    monkeypatch.setitem(KINDS, COUNT.name, COUNT)
    monkeypatch.setitem(sys.modules, __name__, sys.modules[__name__])
    path = tmp_path / "count.toml"
    path.write_text(
        'kind = "count"\nname = "c"\nscenarios = ["tiny.toml"]\nestimators = ["blob[n=3]"]\n'
        "snr_db = [0]\ntrials = 2\noffset = 4\n"
    )
    return load_suite(path)


def test_a_new_kind_is_run_stored_tabulated_and_drawn(suite, tmp_path):
    records = run_suite(suite, tmp_path / "run").rows
    assert records["n_counted"].tolist() == [7, 7]
    stored = Run.open(tmp_path / "run")
    assert stored.suite == suite
    (grid,) = grids_of(stored.rows, "count")
    assert grid.rows == [["blob", "14"]]
    names = [path.name for path in write_run_tables(stored)[0]]
    assert names == ["summary.csv", "summary.md"]
    assert [path.name for path in draw_run(stored)] == ["counts.png"]


def test_parts_of_a_new_kind_are_merged_scored_again_and_compared_in_its_direction(suite, tmp_path):
    suite, merged, less = suite.replace(trials=8), tmp_path / "merged", tmp_path / "less"
    for k in (1, 2):
        run_suite(suite, tmp_path / f"part{k}", execution=Execution(shard=Shard(k, 2)))
    assert merge([tmp_path / "part1", tmp_path / "part2"], merged).run.rows["n_counted"].tolist() == [7] * 8
    assert rescore(merged).changes == []
    run_suite(suite.replace(offset=0), less)
    assert compare(merged, less, tolerances="n_counted=5%").is_regression
    assert not compare(less, merged, tolerances="n_counted=5%").is_regression


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_the_code_that_a_kind_names_exists(kind):
    tables = [kind.tables, *kind.timed_tables.values()]
    names = [kind.plan, kind.figures, *(name for pair in tables for name in pair)]
    assert all(callable(resolve_name(name)) for name in names if name)
    assert {*kind.better} <= {*kind.columns}
