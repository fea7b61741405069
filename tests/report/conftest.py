"""Made-up rows of a timed run."""

import json

import pandas as pd
import pytest

from isacbench.bench.cells.record import COLUMNS, TIMING_COLUMNS
from isacbench.bench.store.run import Run
from isacbench.report.figures import run_figures
from isacbench.report.run_tables import write_run_tables

SCORES = ["density", "velocity_nmse", "chamfer_m", "gospa_m", "precision", "recall"]


@pytest.fixture
def all_axes_named(monkeypatch):
    """Hold every figure that is saved to y axes with names wherever there are curves; list the figures."""
    drawn, save = [], run_figures.save

    def hold(figure, path):
        for axes in (axes for axes in figure.axes if axes.lines):
            assert axes.get_ylabel() not in ("", "mean"), f"{path.stem}: {axes.get_title()}"
        drawn.append(figure)
        return save(figure, path)

    monkeypatch.setattr(run_figures, "save", hold)
    return drawn


@pytest.fixture
def tables_written(tmp_path):
    """Return a function that writes the tables of made-up rows, and returns their paths."""

    def write(records, kind="imaging"):
        manifest = {"suite": {"kind": kind, "scenarios": []}, "scenarios": {}}
        return write_run_tables(Run(str(tmp_path), records, manifest))[0]

    return write


@pytest.fixture
def timed():
    """Rows of a timed run: `timed(fast=(time_s, deviation), ...)`, a number or one a trial each."""

    def rows(n_trials=8, snr_db=10.0, scenario="street", params=None, **estimators):
        found = []
        for trial in range(n_trials):
            for estimator, numbers in estimators.items():
                time_s, deviation = (
                    values[trial] if hasattr(values, "__len__") else values for values in numbers
                )
                found.append(
                    {
                        **dict.fromkeys(SCORES, 0.5),
                        **{f"hausdorff_{plane}_m": deviation / 3 for plane in ("xy", "xz", "yz")},
                        "hausdorff_sum_m": deviation,
                        "scenario": scenario,
                        "estimator": estimator,
                        "params": json.dumps((params or {}).get(estimator, {})),
                        "snr_db": snr_db,
                        "trial": trial,
                        "status": "ok",
                        "reason": "",
                        "n_estimated": 10,
                        "deviation": deviation,
                        "time_estimate_s": time_s,
                        "timing": True,
                    }
                )
        return pd.DataFrame(found).reindex(columns=[*COLUMNS, *TIMING_COLUMNS])

    return rows
