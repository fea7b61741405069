"""Metrics of plugin files: in runs, in rows, under check, and where they fail."""

import numpy as np
import pytest

from isacbench import check
from isacbench.bench.run.runner import run
from isacbench.bench.suites.suite_kinds import load_suite, with_metrics
from isacbench.errors import InputError
from isacbench.metrics.descriptions import ScoreColumn
from isacbench.plugins.discovery import load_plugin_file
from isacbench.plugins.registry import build_metric
from isacbench.plugins.scoring import score

HEIGHT = '''
from dataclasses import dataclass
from typing import ClassVar

from isacbench.plugins.contracts import ScoreColumn


@dataclass(frozen=True)
class Height:
    """Error of the mean height of an image."""

    name: ClassVar[str] = "height"
    columns: ClassVar[tuple[ScoreColumn, ...]] = (ScoreColumn("height_error_m", "error of the height", "m"),)

    def score(self, pair):
        if not len(pair.estimate):
            return {"height_error_m": float("nan")}
        return {"height_error_m": abs(pair.estimate.xyz[:, 2].mean() - pair.truth.xyz[:, 2].mean())}
'''


def check_of_columns(path):
    """Check the metric of a file, and return the message about its columns."""
    (plugin,) = check(path).plugins
    (finding,) = [finding for finding in plugin.findings if finding.check == "columns"]
    return finding.message


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_run_scores_by_the_metric_of_a_file_whatever_process_images(write_plugin, tiny, jobs):
    path = write_plugin("height.py", HEIGHT)
    table = run(
        "quick",
        scenarios=[tiny],
        estimators=["fft4d", "oracle"],
        snr_db=20,
        trials=1,
        metrics="height",
        plugins=[path],
        jobs=jobs,
    )
    assert set(table["status"]) == {"ok"}
    assert np.isfinite(table["height_error_m"]).all()


@pytest.mark.parametrize("name", ["trial", "snr_db", "status", "time_estimate_s", "ratio", "label"])
def test_a_column_never_replaces_another_of_the_rows(write_plugin, tiny, name):
    path = write_plugin("height.py", HEIGHT.replace("height_error_m", name).replace('"m"', '""'))
    with pytest.raises(InputError, match=f"metric height: rows have a column {name} already"):
        run("quick", scenarios=[tiny], estimators=["fft4d"], trials=1, metrics=["height"], plugins=[path])
    assert f"rows of a run have a column {name} already" in check_of_columns(path)


@pytest.mark.parametrize("unit", ["metre", "M", ""])
def test_a_unit_that_the_name_of_the_column_contradicts_is_doubtful(write_plugin, unit):
    path = write_plugin("height.py", HEIGHT.replace('"m"', repr(unit)))
    assert "'m' ends in _m" in check_of_columns(path)


def test_a_direction_that_there_is_not_is_refused():
    with pytest.raises(
        InputError, match="score column x: better = 'hihger': allowed is lower, higher, neither"
    ):
        ScoreColumn("x", "what it is", "", "hihger")


def test_an_exception_of_a_metric_names_the_metric_and_its_line(write_plugin, tiny):
    path = write_plugin("height.py", HEIGHT.replace("return {", "return 1 / 0, {"))
    load_plugin_file(path)
    with pytest.raises(
        InputError, match=r"metric height: score\(\) raised ZeroDivisionError.*height.py, line"
    ):
        score([[0.0, 0, 0, 1]], [[0.0, 0, 1, 1]], build_metric("height"))
    table = run("quick", scenarios=[tiny], estimators=["fft4d"], snr_db=20, trials=1, metrics=["height"])
    assert "metric height: score() raised ZeroDivisionError" in table["reason"].item()


def test_one_further_metric_may_be_given_as_a_text():
    suite = load_suite("quick")
    assert with_metrics(suite, "occupancy") == with_metrics(suite, ["occupancy"])
