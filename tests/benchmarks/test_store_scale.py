"""What a run of a million rows costs beside its estimates: seconds, and memory."""

import math
import resource
import sys
import time

import numpy as np
import pytest

from isacbench.bench.cells.provenance import environment_id, environment_of
from isacbench.bench.cells.rows import Row
from isacbench.bench.run import runner
from isacbench.bench.suites.suite import Suite
from isacbench.model.cloud import PointCloud
from isacbench.report.run_report import draw_run, write_run_tables

MAX_MEMORY_MIB = 4096
N_POINTS = 2
SCORES = [
    *("hausdorff_xy_m", "hausdorff_xz_m", "hausdorff_yz_m", "density", "velocity_nmse", "deviation"),
    *("chamfer_m", "gospa_m", "time_estimate_s", "precision", "recall", "time_score_s"),
]


def largest_memory_mib():
    """Most memory that this process ever held."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20


class Estimates:
    """Made-up outcomes in place of real ones, and the time that making them up takes."""

    def __init__(self):
        self.time_s = 0.0

    def work(self, job, blocks, _repeats):
        random, environments = np.random.default_rng(0), {}
        tick = time.perf_counter()
        for block in blocks:
            task = job.plan.by_name[block.scenario]
            for one in task.entries:
                environment = environments.setdefault(one.name, environment_of(one.plugin))
                place = {"scenario": task.name, "scenario_content": task.content, "trial": block.trial}
                name = environment_id(environment)
                own = {"estimator": one.name, "params": one.params, "environment": name}
                always = {"suite": job.suite.name, "seed": 0, "n_true": 466, "timing": False}
                known = {**place, "snr_db": block.snr_db, **own, **always}
                scores = dict(zip(SCORES, random.random(len(SCORES)).tolist(), strict=True))
                status, n_points = "ok", N_POINTS
                if scores["recall"] < 0.02:
                    scores, status, n_points = {}, "timeout", 0
                found = {"status": status, "reason": "", "n_estimated": n_points, **scores}
                # Random, because no file of real points is as small as one of equal ones.
                cloud = PointCloud.from_array(random.random((n_points, 5)))
                made = Row(known, environment, found, cloud)
                self.time_s += time.perf_counter() - tick
                yield made
                tick = time.perf_counter()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:no map and no spectra")
@pytest.mark.parametrize(
    ("estimators", "n_snrs", "n_trials", "most_s"),
    [
        (["music2d", "fft4d", "oracle", "esprit2d", "nomp4d"], 50, 2000, 60),
        ([f"fft4d[pfa={n}e-6]" for n in range(1, 101)], 10, 500, math.inf),
    ],
    ids=["trials", "variants"],
)
def test_a_million_rows_are_written_resumed_and_reported(
    tmp_path, monkeypatch, estimators, n_snrs, n_trials, most_s
):
    cells = {"estimators": estimators, "snr_db": list(range(-25, n_snrs - 25)), "trials": n_trials}
    suite = Suite(name="million", scenarios=["street", "street-paper"], **cells)
    folder, estimates, spent_s = tmp_path / "run", Estimates(), {}

    def timed(name, function, *arguments):
        estimates.time_s, start = 0.0, time.perf_counter()
        value = function(*arguments)
        spent_s[name] = round(time.perf_counter() - start - estimates.time_s, 1)
        return value

    monkeypatch.setattr(runner, "rows_here", estimates.work)
    written = timed("written", runner.run_suite, suite, folder)
    assert len(written.rows) == 1_000_000
    resumed = timed("resumed", runner.run_suite, suite, folder)
    assert estimates.time_s == 0, "cells were made again"
    assert resumed.rows.equals(written.rows)
    timed("tables", write_run_tables, resumed)
    figures = timed("figures", draw_run, resumed)
    print(spent_s, f"{largest_memory_mib():.0f} MiB")
    assert all(path.stat().st_size for path in (*figures, *folder.glob("*.csv")))
    assert largest_memory_mib() < MAX_MEMORY_MIB
    assert sum(spent_s.values()) < most_s
