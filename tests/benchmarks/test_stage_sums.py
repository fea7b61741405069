"""What stages leave of an estimate, and what marking them costs; printed, for no time decides a test.

Run with ``pytest -m slow -s tests/benchmarks/test_stage_sums.py``.
"""

import timeit

import pytest

from isacbench.bench.run.runner import run
from isacbench.instrument.stages import STAGES, StageClock, stage
from isacbench.plugins.registry import estimator_names

pytestmark = pytest.mark.slow


def test_the_stages_of_every_estimator_sum_up_to_about_the_whole():
    records = run("quick", estimators=estimator_names(), snr_db=[10], trials=1, timing=True, jobs=1)
    assert records["timing"].all()
    assert set(records["status"]) == {"ok"}
    print()
    for row in records.to_dict("records"):
        stages_s = sum(row[f"time_{name}_s"] for name in STAGES)
        total_s = row["time_estimate_s"]
        print(
            f"{row['estimator']:<14} {1e3 * total_s:8.2f} ms (spread {1e3 * row['time_spread_s']:.2f} ms), "
            f"in stages {1e3 * stages_s:8.2f} ms, {stages_s / total_s:.1%}; "
            f"{row['peak_memory_mib']:.1f} MiB"
        )


def mark():
    with stage("rdm"):
        pass


def test_what_a_marker_costs():
    n = 100_000
    unmeasured_s = min(timeit.repeat(mark, number=n)) / n
    with StageClock() as clock:
        measured_s = min(timeit.repeat(mark, number=n)) / n
    assert clock.seconds["rdm"] > 0
    print(f"\na stage costs {1e9 * unmeasured_s:.0f} ns, {1e9 * measured_s:.0f} ns where it is measured")
