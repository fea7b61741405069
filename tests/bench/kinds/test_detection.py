import json
import math

import numpy as np
import pandas as pd
import pytest

from isacbench.bench.cells.images import Image
from isacbench.bench.kinds.detection import MAP_GAIN_DB, DetectionKind, DetectionSuite, count_cells
from isacbench.bench.kinds.power_maps import draw_power_map
from isacbench.bench.run.runner import run
from isacbench.errors import InputError
from isacbench.model.cloud import PointCloud
from isacbench.model.echo import observe_echo
from isacbench.plugins.contracts import Detection, Diagnosis
from isacbench.plugins.registry import get_detector

BAD = """
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from isacbench.plugins.contracts import Detection


@dataclass(frozen=True)
class Bad:
    name: ClassVar[str] = "bad"
    pfa: float = 1e-3
    kind: str = "write"

    def detect(self, power, looks=1):
        if self.kind == "write":
            power[0] = 0
        if self.kind == "list":
            return [1, 2]
        shape = (3, 3) if self.kind == "shape" else power.shape
        return Detection(np.zeros(shape, dtype=bool), power, power)
"""


@pytest.fixture
def suite(plugins, tiny):
    return DetectionSuite(
        name="test",
        scenarios=[str(tiny)],
        estimators=["blob"],
        detectors=["level", "ca[training=2]"],
        maps=["homogeneous"],
        pfa=[1e-2, 1e-3],
        snr_gain_db=[10, 20],
        trials=2,
    )


def test_maps_meet_every_detector_at_every_rate_and_scenarios_the_estimators_behind_them(records):
    on_map, imaged = (records[records["scenario"] == name] for name in ("homogeneous", "tiny"))
    assert (len(on_map), len(imaged)) == (2 * 2 * 2 * 2, 2 * 2 * 2)
    assert set(on_map["estimator"]) == {"level", "ca"}
    assert set(on_map["detector"]) == set(imaged["detector"]) == {"level", "ca[training=2]"}
    assert set(on_map["pfa"]) == {1e-2, 1e-3}
    assert on_map["deviation"].isna().all()
    assert set(on_map["n_true"]) == {128}
    assert set(imaged["estimator"]) == {"blob"}
    assert {json.loads(params)["detector"]["name"] for params in imaged["params"]} == {"level", "ca"}
    # An estimator that does not show its map has nothing counted.
    imaged = DetectionKind().summary(records).query("scenario == 'tiny'")
    assert (imaged["n_targets"] == 0).all()
    assert imaged["pd"].isna().all()
    assert imaged["deviation_mean"].notna().all()


def test_a_row_of_a_map_counts_what_the_detector_marks(records):
    row = records.query("estimator == 'ca' and pfa == 0.01 and trial == 0 and snr_gain_db == 20").iloc[0]
    drawn = draw_power_map("homogeneous", 0, 0)
    mask = get_detector("ca", training=2, pfa=0.01).detect(drawn.power(20.0)).mask
    assert row["snr_db"] == pytest.approx(20 - MAP_GAIN_DB)
    assert row["n_estimated"] == mask.sum()
    assert (row["n_targets"], row["n_hits"]) == (drawn.targets.sum(), (mask & drawn.targets).sum())
    assert (row["n_clear"], row["n_false"]) == (drawn.clear.sum(), (mask & drawn.clear).sum())


def test_without_rates_each_detector_keeps_its_own(suite):
    records = run(suite.replace(detectors=["ca[pfa=1e-4]", "level"], pfa=[], maps=[]), trials=1)
    assert records.groupby("detector")["pfa"].unique().map(list).to_dict() == {
        "ca[pfa=1e-4]": [1e-4],
        "level": [1e-3],
    }


FAILURES = {
    "write": "ValueError: assignment destination is read-only (bad_plugins.py, line 18, in detect)",
    "list": "TypeError: detect() must return a Detection, not list",
    "shape": "ValueError: detect() must mark cells of a map of shape (128, 1024), not bool (3, 3)",
}


def test_a_detector_that_fails_is_a_row_with_its_reason_and_one_that_sees_nothing_no_detection(
    suite, plugin_folder
):
    plugin_folder.install("bad-plugins", BAD, detectors={"bad": "Bad"})
    bad = {kind: f"bad[kind={kind}]" for kind in (*FAILURES, "none")}
    records = run(suite.replace(detectors=[*bad.values(), "level"], pfa=[1e-3]), snr_db=[0], trials=1)
    on_map = records[records["scenario"] == "homogeneous"].set_index("detector")
    summary = DetectionKind().summary(records).set_index(["scenario", "detector"])
    for kind, reason in FAILURES.items():
        row = on_map.loc[bad[kind]]
        assert (row["status"], row["reason"], row["n_targets"]) == ("error", reason, 0)
        assert summary.loc[("homogeneous", bad[kind]), "n_failed"] == 1
    assert on_map.loc[bad["none"], "status"] == "no_detection"
    assert on_map.loc["level", "status"] == "ok"


class Shower:
    """Has looked at a map in which some cells exceed the threshold."""

    def __init__(self, cells):
        self.cells = np.array(cells)

    def estimate(self, observation):
        return PointCloud.empty()

    def diagnose(self, observation):
        gate, power = observation.gate, np.ones(observation.gate.shape)
        mask = np.zeros(gate.shape, dtype=bool)
        mask[tuple((self.cells - [gate.range_bins[0], gate.doppler_bins[0]]).T)] = True
        return Diagnosis(power, Detection(mask, power, power), gate.range_bins, gate.doppler_bins, (), None)


def test_cells_of_an_image_are_counted_nearest_to_scatterers_and_far_from_all_of_them(room, put):
    system = room.system
    bins = np.array([[25.2, 1.3], [28.4, -2.4]])
    places = [[r * system.range_bin_m, v * system.velocity_bin_mps, 0.0, 0.0] for r, v in bins]
    scenario = put(room, places)
    observation = observe_echo(scenario, 0.0)
    # Nearest to the first, beside the second, far from both, and just not far.
    shower = Shower([(25, 1), (28, -3), (25, 9), (25, 4)])
    counts = count_cells(Image(scenario, observation, shower, 0.0, PointCloud.empty()))
    rows, columns = observation.gate.shape
    far = sum(
        all(max(abs(row - r), abs(column - v)) > 3 for r, v in ((25, 1), (28, -2)))
        for row in observation.gate.range_bins
        for column in observation.gate.doppler_bins
    )
    assert counts == {"n_targets": 2, "n_hits": 1, "n_clear": far, "n_false": 1}
    assert far < rows * columns


def test_the_summary_pools_the_counts_of_trials(records):
    summary = DetectionKind().summary(records)
    row = summary[(summary["estimator"] == "ca") & (summary["pfa"] == 1e-2)].iloc[0]
    part = records[(records["params"] == row["params"]) & (records["snr_db"] == row["snr_db"])]
    assert row["n_cells"] == len(part) == 2
    assert row["pd"] == part["n_hits"].sum() / part["n_targets"].sum()
    assert math.isnan(row["pd_low"])
    often = DetectionKind().summary(pd.concat([records] * 3, ignore_index=True)).loc[row.name]
    assert often["pd_low"] < row["pd"] == often["pd"] < often["pd_high"]
    assert row["pfa_measured"] == part["n_false"].sum() / part["n_clear"].sum()
    assert math.isnan(row["deviation_mean"])


def test_a_map_has_a_table_at_the_papers_rate_and_a_scenario_one_of_deviations_too(suite):
    detectors = ["level", "ca", "ca[guard=2]", "ca[guard=3]"]
    records = run(suite.replace(detectors=detectors, maps=["homogeneous", "interferers"]), trials=1)
    homogeneous, interferers, tiny = DetectionKind().tables(records)
    assert homogeneous.title == "homogeneous: P_d and P_fa of a nominal 0.001"
    assert homogeneous.headings[1:] == interferers.headings[1:] == detectors
    assert [row[0] for row in homogeneous.texts] == ["10", "20"]
    detected, false = map(float, homogeneous.texts[1][2].split())
    assert 0.9 < detected < 1
    assert 5e-4 < false < 2e-3
    assert tiny.headings[2:] == detectors
    # No map is shown by this estimator, so that there is nothing to count.
    assert tiny.texts[0][2].endswith(" - -")
    assert float(tiny.texts[0][2].split()[0]) > 0


def drawn(chart):
    """Points of the series of a chart that have a symbol."""
    return {one.label: list(zip(one.x, one.y, strict=True)) for one in chart.series if one.style.symbol}


def test_charts_of_maps_are_rates_over_the_snr_and_over_each_other(records):
    summary = DetectionKind().summary(records).query("scenario == 'homogeneous' and estimator == 'ca'")
    maps, roc, _ = DetectionKind().charts(records.iloc[::-1])
    detected, false = maps.charts
    of_paper = summary[summary["pfa"] == 1e-3]
    for chart, column in ((detected, "pd"), (false, "pfa_measured")):
        points = list(zip(of_paper["snr_gain_db"], of_paper[column], strict=True))
        assert drawn(chart)["ca[training=2]"] == points
        assert set(drawn(chart)) == {"level", "ca[training=2]"}
    limit = detected.series[-1]
    snr = 10 ** (limit.x[0] / 10)
    assert (limit.label, limit.y[0]) == ("known noise (closed form)", pytest.approx(1e-3 ** (1 / (1 + snr))))
    assert false.lines == [1e-3]
    assert [chart.title for chart in roc.charts] == ["homogeneous, 10 dB", "homogeneous, 20 dB"]
    at_20_db = summary[summary["snr_gain_db"] == 20].sort_values("pfa_measured")
    points = list(zip(at_20_db["pfa_measured"], at_20_db["pd"], strict=True))
    assert drawn(roc.charts[1])["ca[training=2]"] == points
    assert roc.charts[0].x == roc.charts[1].x
    # A count of no false alarm has a place on the logarithmic axis, below one.
    _, false = DetectionKind().charts(records.assign(n_false=0))[0].charts
    assert {y for points in drawn(false).values() for _, y in points} == {0.1 / of_paper["n_clear"].iloc[0]}


def test_deviation_detection_and_false_alarms_of_a_scenario_stand_side_by_side(records):
    imaged = records[records["scenario"] == "tiny"]
    (group,) = DetectionKind().charts(imaged)
    deviation, detected, false = group.charts
    of_level = DetectionKind().summary(imaged).query("detector == 'level'")
    points = list(zip(of_level["snr_db"], of_level["deviation_mean"], strict=True))
    assert drawn(deviation)["level"] == points
    assert false.lines == [1e-3]
    assert [one.label for one in detected.series] == ["level: no score", "ca[training=2]: no score"]
    assert group.stem == "detection-tiny"
    assert "blob behind each detector" in group.title


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"detectors": ["cs"]}, "unknown detector 'cs'"),
        ({"detectors": ["ca", "ca[training=3]"]}, r"detectors: 'ca\[training=3\]' repeats a detector"),
        ({"estimators": ["seer"]}, "estimators: 'seer': allowed are estimators with a parameter detector"),
        ({"pfa": [0.0]}, r"pfa\[0\] = 0.0: input should be greater than 0"),
        ({"estimators": ["blob[detector=ca]"]}, "which is not set; list detectors under the key"),
    ],
)
def test_a_mistake_is_found_before_anything_runs(suite, tmp_path, change, message):
    with pytest.raises(InputError, match=message):
        run(suite.replace(**change), out=tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_scenario_must_not_have_the_name_of_a_map(suite, tiny):
    tiny.write_text(tiny.read_text().replace('"tiny"', '"homogeneous"'))
    with pytest.raises(InputError, match="'homogeneous' is the name of a map as well"):
        run(suite)
