"""The kind ``drops``: its numbers against a recount from the clouds on disk, verdicts, and refused drops."""

import json
import math

import numpy as np
import pandas as pd
import pytest

from isacbench import compare, load_run, load_scenario, rank
from isacbench.bench.kinds.drops import DropsKind, DropsSuite, configuration_of, verdicts
from isacbench.bench.kinds.kind import with_labels
from isacbench.bench.run.runner import run_suite

SCENARIOS = ["uma-av[seed=0:5]", "uma-av[seed=10:12,targets=0]"]
PFAS = "1e-4", "3e-2"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Run with a detector of many false alarms."""
    out = tmp_path_factory.mktemp("drops") / "run"
    estimators = [f"fft4d[pfa={pfa}]" for pfa in PFAS]
    suite = DropsSuite(name="test", scenarios=SCENARIOS, estimators=estimators, snr_db=[-20], trials=1)
    run_suite(suite, out)
    return out


def nearest_pairs(truth, found, gate_m):
    """Associate greedily by distance: for few, far drones as good as any."""
    pairs = [(math.dist(a, b), i, j) for i, a in enumerate(truth) for j, b in enumerate(found)]
    kept = []
    for distance, i, j in sorted(pairs):
        if distance <= gate_m and all(i != i2 and j != j2 for _, i2, j2 in kept):
            kept.append((distance, i, j))
    return kept


@pytest.mark.parametrize("pfa", PFAS)
def test_numbers_are_those_of_the_clouds_on_disk(folder, pfa):
    """Each point of these sparse clouds is a detection of its own."""
    run = load_run(folder)
    rows = run.rows
    own = rows[[json.loads(params)["pfa"] == float(pfa) for params in rows["params"]]]
    missed, false, pooled, errors, alarms = [], [], [0, 0], [], []
    for row in own.to_dict("records"):
        scenario = load_scenario(row["scenario"])
        cloud = run.cloud(row)
        n = row["n_detections"]
        assert n == len(cloud)
        if "targets=0" in row["scenario"]:
            alarms.append(len(cloud) > 0)
            continue
        kept = nearest_pairs(scenario.truth.xyz.tolist(), cloud.xyz.tolist(), 22.6)
        missed.append(1 - len(kept) / 5)
        false.append(1 - len(kept) / n if n else 0)
        pooled = [pooled[0] + n - len(kept), pooled[1] + n]
        errors += [math.dist(scenario.truth.xyz[i, :2], cloud.xyz[j, :2]) for _, i, j in kept]
    summary = run_summary(own)
    assert summary["missed_detection"] == pytest.approx(np.mean(missed))
    assert summary["false_alarm_type2"] == pytest.approx(np.mean(false))
    assert summary["false_alarm_type2_pooled"] == pytest.approx(pooled[0] / pooled[1])
    assert summary["false_alarm_type1"] == pytest.approx(np.mean(alarms))
    assert summary["horizontal_error_p90_m"] == pytest.approx(np.percentile(errors, 90))


def run_summary(rows):
    (summary,) = DropsKind().summary(rows).to_dict("records")
    return summary


def test_means_of_the_metrics_columns_are_those_of_the_summary(folder):
    rows = pd.read_parquet(folder / "results.parquet")
    for _, own in rows.groupby("params"):
        summary = run_summary(own)
        for name in ("missed_detection", "false_alarm_type1", "false_alarm_type2"):
            assert own[name].mean() == pytest.approx(summary[name])
            assert summary[f"{name}_low"] <= summary[name] <= summary[f"{name}_high"]


def test_the_effective_snr_is_that_of_the_link_budget(folder):
    rows = pd.read_parquet(folder / "results.parquet").drop_duplicates("scenario")
    for row in rows[rows["n_targets"] > 0].to_dict("records"):
        echoes = load_scenario(row["scenario"]).truth.power.sum()
        assert row["snr_effective_db"] == pytest.approx(row["snr_db"] + 10 * np.log10(echoes))


def test_the_gate_curve_ascends_and_the_manifest_has_the_gate(folder):
    rows = pd.read_parquet(folder / "results.parquet")
    for text in rows["detected_by_gate"]:
        counts = [int(part) for part in text.strip("[]").split(",")]
        assert counts == sorted(counts)
    assert '"gate_m": 22.6' in (folder / "manifest.json").read_text()


def test_verdicts_are_by_the_categories_that_the_suite_names(tmp_path):
    metrics = ["nr-isac", "ts22137[target=vehicle,public_safety=true]"]
    suite = DropsSuite(
        name="test", scenarios=["uma-av[seed=0]"], estimators=["fft4d"], snr_db=[0], trials=1, metrics=metrics
    )
    rows = run_suite(suite, tmp_path / "run").rows
    fourth = json.loads(rows["categories"].iloc[0])[3]
    assert (fourth[0], fourth[3]) == (0.99, 15.0)
    assert "from" not in verdicts(with_labels(rows))[3]["missed"]  # five drones are too few to tell


def test_verdicts_say_from_which_snr_on_a_limit_is_kept(folder):
    rows = with_labels(pd.read_parquet(folder / "results.parquet"))
    many = pd.concat([rows] * 40).reset_index(drop=True)
    better = many.assign(snr_db=0.0, n_detected=many["n_targets"], n_detections=many["n_targets"])
    texts = verdicts(pd.concat([many, better]))
    assert len(texts) == 4 * len(PFAS)
    for text in texts:
        assert text["missed"].startswith("from 0 dB: 0 (")
        assert ("radial velocity" in text) == (text["category"] != "1")


@pytest.mark.parametrize(
    ("name", "configuration"),
    [
        ("uma-av[seed=3,targets=0]", "uma-av"),
        ("uma-av[seed=3,clutter=ground]", "uma-av[clutter=ground]"),
        ("street", "street"),
    ],
)
def test_drops_of_one_configuration_belong_together(name, configuration):
    assert configuration_of(name) == configuration


def test_estimators_are_ranked_over_the_drops_that_have_targets(folder):
    ranking = rank(folder, metric="missed_detection")
    assert set(ranking.ranks["n_scenes"]) == {6}
    rows = load_run(folder).rows
    by_params = rows.groupby("params")["missed_detection"].mean()
    ranked = ranking.ranks.set_index("params")["mean"]
    np.testing.assert_allclose(ranked.sort_index(), by_params.sort_index())


def test_runs_of_drops_are_compared_by_missed_targets(folder):
    found = compare(folder, folder, tolerances="missed_detection=0.05")
    assert not found.is_regression
    assert "missed_detection" in set(found.curves["metric"])


def test_drops_without_detections_have_no_false_ones_at_any_gate(folder):
    rows = load_run(folder).rows
    (params, *_) = rows["params"].unique()
    full = rows[(rows["params"] == params) & (rows["n_targets"] > 0)].iloc[[0, 1]]
    n_gates = len(json.loads(full["detected_by_gate"].iloc[0]))
    nothing = full.iloc[[1]].assign(n_detections=0, n_detected=0, detected_by_gate=json.dumps([0] * n_gates))
    alone, both = full.iloc[[0]], pd.concat([full.iloc[[0]], nothing])
    (one,), (two,) = (gate_series(part, "Type 2 over the gate") for part in (alone, both))
    np.testing.assert_allclose(two, one / 2)
    (one,), (two,) = (gate_series(part, "missed over the gate") for part in (alone, both))
    np.testing.assert_allclose(two, (one + 1) / 2)


def gate_series(rows, title):
    """Curves of a chart over the gate."""
    (group,) = DropsKind().charts(rows)
    (chart,) = (chart for chart in group.charts if chart.title == title)
    return [np.asarray(series.y) for series in chart.series]
