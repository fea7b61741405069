"""What a report of a million rows costs: seconds, and memory beyond the tables themselves."""

import itertools
import json
import time
from datetime import UTC, datetime

import numpy as np
import pandas as pd
import pytest

from isacbench.bench.cells.record import CLOUD_KEYS, DRAW_COLUMNS, Results
from isacbench.bench.plan.job import load_job
from isacbench.bench.store.csv_table import write_csv_table
from isacbench.bench.store.run_store import describe_run, describe_session, write_manifest, write_results
from isacbench.bench.suites.suite import Suite
from isacbench.model.cloud_files.point_files import POINT_COLUMNS
from isacbench.model.scenes.scenario import load_scenario
from isacbench.report.figures.run_figures import draw_run
from isacbench.report.tables.run_tables import score_grids
from isacbench.report.tables.tables_by_kind import write_run_tables
from tests.benchmarks.conftest import SCORES, largest_memory_mib

N_POINTS = 2
MAX_MEMORY_MIB = 2048


def made_up_results(n_snrs, n_trials, n_variants):
    """Results of two scenarios with random scores, every fiftieth cell a failure."""
    random = np.random.default_rng(0)
    names = "street", "street-paper"
    params = [json.dumps({"detector": "osca", "n": n}) for n in range(n_variants)]
    suite = Suite(
        name="made-up",
        scenarios=list(names),
        estimators=["fft4d"],
        snr_db=np.linspace(-30, 20, n_snrs).tolist(),
        trials=n_trials,
    )
    axes = [np.arange(len(values)) for values in (names, suite.snr_db, range(n_trials), params)]
    scenario, snr, trial, variant = (index.ravel() for index in np.meshgrid(*axes, indexing="ij"))
    n = len(trial)
    failed = np.arange(n) % 50 == 0
    records = pd.DataFrame(
        {
            "suite": suite.name,
            "scenario": np.array(names, dtype=object)[scenario],
            "estimator": "fft4d",
            "params": np.array(params, dtype=object)[variant],
            "snr_db": np.array(suite.snr_db)[snr],
            "trial": trial,
            "seed": 0,
            "status": np.where(failed, "timeout", "ok"),
            "reason": np.where(failed, "longer than 10 s", ""),
            "n_true": 466,
            "n_estimated": np.where(failed, 0, N_POINTS),
            **{name: np.where(failed, np.nan, random.random(n)) for name in SCORES},
            "timing": False,
            "scenario_content": "made up",
            "environment": "",
        }
    )
    clouds = records[CLOUD_KEYS].loc[np.repeat(records.index, N_POINTS)].reset_index(drop=True)
    clouds[POINT_COLUMNS] = 10 * random.random((len(clouds), len(POINT_COLUMNS)))
    return Results(
        suite=suite,
        records=records,
        clouds=clouds,
        scenarios={name: load_scenario(name) for name in names},
        draws=pd.DataFrame(columns=DRAW_COLUMNS),
        environments={},
        started=datetime.now(UTC),
        wall_time_s=0.0,
        interrupted=False,
    )


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:no map and no spectra")
@pytest.mark.parametrize(
    ("n_snrs", "n_trials", "n_variants"), [(50, 10_000, 1), (10, 500, 100)], ids=["trials", "variants"]
)
def test_a_million_rows_are_reported(tmp_path, n_snrs, n_trials, n_variants):
    results = made_up_results(n_snrs, n_trials, n_variants)
    assert len(results.records) == 1_000_000
    write_results(results, tmp_path)
    session = describe_session(results.started, 0.0, False, {})
    write_manifest(tmp_path, describe_run(load_job(results.suite)), {}, [session])
    before_mib = largest_memory_mib()
    spent_s = {}

    def timed(name, function, *arguments):
        start = time.perf_counter()
        value = function(*arguments)
        spent_s[name] = round(time.perf_counter() - start, 2)
        return value

    timed("csv", write_csv_table, results.records, tmp_path / "results.csv")
    grids = timed("grids", score_grids, results.records)
    timed("tables", write_run_tables, tmp_path, results.records)
    figures = timed("figures", draw_run, tmp_path)
    memory_mib = largest_memory_mib() - before_mib
    print(spent_s, f"{memory_mib:.0f} MiB beyond the tables")
    assert sum("deviation" in name for grid in grids for name in grid.header) == 2 * n_variants
    assert all(path.stat().st_size for path in itertools.chain(figures, tmp_path.glob("*.csv")))
    assert memory_mib < MAX_MEMORY_MIB
