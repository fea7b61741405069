"""What a run of a million rows costs beside its estimates: seconds, and memory."""

import time

import numpy as np
import pytest

from isacbench.bench.cells.record import Cell, Outcome, Record
from isacbench.bench.run import runner
from isacbench.bench.store.provenance import Made, environment_id, environment_of
from isacbench.bench.suites.suite import Suite
from isacbench.model.cloud import PointCloud
from isacbench.report.figures.run_figures import draw_run
from isacbench.report.tables.tables_by_kind import write_run_tables
from tests.benchmarks.conftest import SCORES, largest_memory_mib

MAX_MEMORY_MIB = 4096
N_POINTS = 2


class Estimates:
    """Made-up outcomes in place of real ones, and the time that making them up takes."""

    def __init__(self):
        self.time_s = 0.0

    def work(self, job, blocks, _repeats):
        random, environments = np.random.default_rng(0), {}
        tick = time.perf_counter()
        for block in blocks:
            scene = job.plan.scenes[block.scene]
            for index in block.entries:
                one = scene.entries[index]
                environment = environments.setdefault(one.name, environment_of(one.plugin))
                name = environment_id(environment)
                key = Cell(
                    job.suite.name,
                    scene.name,
                    one.name,
                    one.params,
                    block.snr_db,
                    block.trial,
                    0,
                    scene.content,
                )
                scores = dict(zip(SCORES, random.random(len(SCORES)).tolist(), strict=True))
                record = Record(
                    **vars(key), status="ok", reason="", n_true=466, n_estimated=2, **scores, environment=name
                )
                # Random, because no file of real points is as small as one of equal ones.
                cloud = PointCloud.from_array(random.random((N_POINTS, 5)))
                made = Made(Outcome(record, cloud), environment)
                self.time_s += time.perf_counter() - tick
                yield made
                tick = time.perf_counter()


@pytest.mark.slow
def test_a_million_rows_are_written_resumed_and_reported(tmp_path, monkeypatch):
    suite = Suite(
        name="million",
        scenarios=["street", "street-paper"],
        estimators=["music2d", "fft4d", "oracle", "esprit2d", "nomp4d"],
        snr_db=list(range(-25, 25)),
        trials=2000,
    )
    estimates = Estimates()
    monkeypatch.setattr(runner, "work_here", estimates.work)
    spent_s = {}
    start = time.perf_counter()
    written = runner.run_suite(suite, tmp_path / "run")
    spent_s["written"] = time.perf_counter() - start - estimates.time_s
    assert len(written.records) == 1_000_000
    estimates.time_s = 0.0
    start = time.perf_counter()
    resumed = runner.run_suite(suite, tmp_path / "run")
    spent_s["resumed"] = time.perf_counter() - start
    assert estimates.time_s == 0, "cells were made again"
    assert resumed.records.equals(written.records)
    start = time.perf_counter()
    write_run_tables(tmp_path / "run", resumed.records)
    draw_run(tmp_path / "run")
    spent_s["reported"] = time.perf_counter() - start
    print({name: round(value, 1) for name, value in spent_s.items()}, f"{largest_memory_mib():.0f} MiB")
    assert largest_memory_mib() < MAX_MEMORY_MIB
    assert sum(spent_s.values()) < 60
