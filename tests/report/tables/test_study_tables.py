import json
from pkgutil import resolve_name

import numpy as np
import pandas as pd
import pytest

from isacbench.bench.run.runner import run
from isacbench.bench.suites.detection_kind import DetectionSuite
from isacbench.bench.suites.resolution_kind import ResolutionSuite
from isacbench.bench.suites.suite import Suite
from isacbench.bench.suites.suite_kinds import KINDS
from isacbench.report.tables.failures import failure_grids
from isacbench.report.tables.tables_by_kind import grids_of
from tests.report.tables.printed import printed

WIDTH = 100
COMMON = {"name": "test", "trials": 2}
STUDIES = ["efficiency", "resolution", "detection"]


@pytest.fixture
def suites(plugins, room_file, tiny):
    return {
        "efficiency": Suite(
            **COMMON,
            kind="efficiency",
            scenarios=[str(room_file)],
            estimators=["seer", "trouble", "trouble[kind=empty]"],
            snr_gain_db=[20, 25.25],
        ),
        "resolution": ResolutionSuite(
            **COMMON,
            scenarios=[str(room_file)],
            estimators=["seer", "blob", "trouble", *(f"blob[n={n}]" for n in (1, 2, 3))],
            dimensions=["velocity", "w"],
            separations_cells=[0.25, 1],
            phases_deg=[0, 90],
            snr_gain_db=[60],
        ),
        "detection": DetectionSuite(
            **COMMON,
            scenarios=[str(tiny)],
            estimators=["blob"],
            detectors=["level", "ca", "osca", *(f"ca[guard={n}]" for n in (2, 3, 4))],
            maps=["homogeneous", "interferers"],
            pfa=[1e-2, 1e-3],
            snr_gain_db=[10, 20],
        ),
    }


@pytest.fixture(scope="module")
def runs():
    """Rows of the suites that have been run, by kind."""
    return {}


@pytest.fixture
def rows_of(suites, runs):
    """Return a function that gives the rows of a suite of a kind, which is run once."""

    def rows(kind):
        if kind not in runs:
            runs[kind] = run(suites[kind])
        return runs[kind].copy()

    return rows


@pytest.mark.parametrize("kind", ["efficiency", "resolution"])
def test_times_are_medians_of_the_cells_that_did_not_fail(rows_of, kind):
    records = rows_of(kind)
    times_s = np.random.default_rng(0).permutation(len(records)) ** 2 / 1e3
    records["time_estimate_s"] = np.where(records["status"] == "error", 1e6, times_s)
    wanted = records[records["estimator"] == "seer"]["time_estimate_s"].median()
    first = grids_of(records, kind)[0]
    text = first.title if kind == "efficiency" else f"time {first.rows[-1][2]} ms"
    assert text.replace(" (not measured alone)", "").endswith(f"time {1e3 * wanted:.1f} ms")


@pytest.mark.parametrize("kind", STUDIES)
def test_every_table_fits_a_terminal_of_a_hundred_columns_and_is_written_with_the_summary(
    rows_of, tables_written, kind
):
    records = rows_of(kind)
    grids = grids_of(records, kind)
    for grid in grids:
        assert all(len(row) == len(grid.header) for row in grid.rows)
        assert max(map(len, printed(grid))) <= WIDTH
    paths = tables_written(records, kind)
    summary = pd.read_csv(paths[0])
    assert len(summary) == len(resolve_name(KINDS[kind].tables.summary)(records))
    assert isinstance(json.loads(summary["params"].iloc[0]), dict)
    lines = paths[1].read_text(encoding="utf-8").splitlines()
    assert sum(line.startswith("**") for line in lines) == len(grids) + len(failure_grids(records))


def test_efficiency_has_a_table_an_estimator_with_misses_failures_and_ratios(rows_of):
    seer, failed, empty = grids_of(rows_of("efficiency"), "efficiency")
    assert seer.title.startswith(
        "room, seer: error over Cramér-Rao bound, 2 trials, no confidence interval below 5"
    )
    assert [row[:3] for row in seer.rows] == [["20", "0.000", "0"], ["25.25", "0.000", "0"]]
    assert failed.rows[0][1:] == ["0.000 (2 failed)", "0", "", "", "", ""]
    assert empty.rows[0][1] == "1.000"


def test_resolution_has_a_row_a_distance_under_the_name_of_its_dimension(rows_of):
    first, second = grids_of(rows_of("resolution"), "resolution")
    assert [row[:2] for row in first.rows] == [
        ["velocity", "0.25"],
        ["", "1"],
        ["w", "0.25"],
        ["", "1"],
        ["time [ms]", ""],
    ]
    assert first.rows[0][2:4] == ["1.00 / 1.00", "0.00 / 0.00"]
    assert first.rows[0][4] == "0.00 / 0.00 (4 failed)"
    assert len(first.header) + len(second.header) == 2 * 2 + 6


def test_detection_has_a_table_a_map_at_the_papers_rate_and_one_a_scenario(rows_of):
    homogeneous, interferers, tiny, more = grids_of(rows_of("detection"), "detection")
    assert homogeneous.title == "homogeneous: P_d and P_fa of a nominal 0.001"
    assert homogeneous.header[1:4] == interferers.header[1:4] == ["level", "ca", "osca"]
    assert [row[0] for row in homogeneous.rows] == ["10", "20"]
    detected, false = map(float, homogeneous.rows[1][2].split())
    assert 0.9 < detected < 1
    assert 5e-4 < false < 2e-3
    assert tiny.header[2:] == ["level", "ca", "osca"]
    assert more.header[2:] == ["ca[guard=2]", "ca[guard=3]", "ca[guard=4]"]
    # No map is shown by this estimator, so that there is nothing to count.
    assert tiny.rows[0][2].endswith(" - -")
    assert float(tiny.rows[0][2].split()[0]) > 0
