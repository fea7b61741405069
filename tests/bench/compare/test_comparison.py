import copy
import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom, wilcoxon

from isacbench import compare
from isacbench.bench.compare.comparison import (
    DEFAULT_TOLERANCE,
    Tolerance,
    compare_tables,
    direction,
    merge_tolerances,
    parse_tolerance,
    share_level,
)
from isacbench.bench.compare.pairs import NotComparableError, code_version
from isacbench.bench.store.run import Run
from isacbench.errors import InputError
from isacbench.plugins.scoring import Metrics
from isacbench.report.comparison import ComparisonReport

DESCRIBED = Metrics().columns(())
KEYS = ["metric", "scenario", "estimator", "params"]


@pytest.fixture
def two_runs(made_run, remembered):
    """Return a function that makes up a run and a second one, equal but for a change to its records."""

    def make(change=lambda records: None, **options):
        made = str(options)
        if made not in remembered:
            remembered[made] = made_run(**options)
        base, new = (Run(name, *copy.deepcopy(remembered[made])) for name in ("base", "new"))
        change(new.rows)
        return base, new

    return make


def scaled(factor, estimator="music2d", snr_db=None, spread=0.0):
    """Change of an estimator's deviation by a factor, the same or nearly so in every trial."""

    def change(records):
        chosen = records["estimator"] == estimator
        if snr_db is not None:
            chosen &= records["snr_db"] == snr_db
        noise = np.random.default_rng(1).normal(0, spread, chosen.sum())
        records.loc[chosen, "deviation"] *= factor + noise

    return change


def verdicts(table):
    return table.groupby("estimator")["verdict"].agg(lambda values: "/".join(sorted(set(values)))).to_dict()


def test_a_run_of_a_single_trial_is_the_same_as_itself_in_every_point(two_runs):
    found = compare_tables(*two_runs(trials=1))
    assert set(found.curves["verdict"]) == set(found.points["verdict"]) == {"same"}
    assert (found.curves["p_worse"] == 1).all()
    assert not found.is_regression
    assert not found.notes


def test_a_curve_is_judged_by_its_change_and_the_tolerance_however_significant(two_runs):
    factors = {"rounded": 1 + 1e-12, "within": 1.02, "worse": 1.1, "better": 0.8}
    spread = np.random.default_rng(1).normal(0, 0.05, 60)

    def change(records):
        for name, factor in factors.items():
            chosen = records["estimator"] == name
            records.loc[chosen, "deviation"] *= factor + (spread if name == "worse" else 0)

    found = compare_tables(*two_runs(change, trials=20, estimators=("fft4d", *factors)))
    assert verdicts(found.curves) == {
        "fft4d": "same",
        "rounded": "same",
        "within": "same",
        "worse": "regression",
        "better": "improvement",
    }
    assert found.is_regression
    curves = found.curves.set_index("estimator")
    assert (found.points.set_index("estimator").loc["rounded", "change"] == 0).all()
    assert curves.loc["within", "p_worse"] < 0.01
    row = curves.loc["worse"]
    assert row["relative_low"] < 0.1 < row["relative_high"]
    assert row["n_pairs"] == 20


def test_a_single_point_that_got_worse_is_found_among_curves_that_stay_within_the_tolerance(two_runs):
    snr_db = [*range(-20, 15, 5)]
    found = compare_tables(*two_runs(scaled(1.15, snr_db=10, spread=0.05), trials=20, snr_db=snr_db))
    worse = found.points[found.points["verdict"] == "regression"]
    assert worse[["estimator", "snr_db"]].to_numpy().tolist() == [["music2d", 10]]
    assert "regression" not in set(found.curves["verdict"])
    assert found.is_regression


def test_a_tolerance_is_relative_or_absolute_and_replaces_the_default(two_runs):
    runs = two_runs(scaled(1.02), trials=20)
    assert compare_tables(*runs, [parse_tolerance("deviation=1%")]).is_regression
    absolute = compare_tables(*runs, [parse_tolerance("deviation=0.5")])
    assert not absolute.is_regression
    assert (absolute.curves["limit"] == 0.5).all()


def test_few_trials_are_inconclusive_and_told_how_many_are_needed(two_runs):
    found = compare_tables(*two_runs(scaled(1.5), trials=2))
    (row,) = found.curves[found.curves["estimator"] == "music2d"].to_dict("records")
    assert row["verdict"] == "inconclusive"
    assert row["smallest_effect"] == math.inf
    assert row["trials_needed"] == 8  # 2^-8 < 0.01 / 2 < 2^-7
    assert math.isnan(row["relative_low"])
    assert not found.is_regression
    needed = int(found.points["trials_needed"].max())
    assert needed > 8
    for trials, verdict in ((needed - 1, "inconclusive"), (needed, "regression")):
        points = compare_tables(*two_runs(scaled(1.5), trials=trials)).points
        assert verdicts(points)["music2d"] == verdict


def test_noise_of_trials_that_hides_a_change_is_inconclusive_with_the_effect_it_would_show(two_runs):
    found = compare_tables(*two_runs(scaled(1.0, spread=0.5), trials=12))
    (row,) = found.curves[found.curves["estimator"] == "music2d"].to_dict("records")
    assert row["verdict"] == "inconclusive"
    assert row["limit"] < row["smallest_effect"] < np.inf


def test_what_is_unchanged_costs_what_changed_no_level(two_runs):
    found = compare_tables(*two_runs(scaled(1.1, spread=0.02)))
    assert verdicts(found.curves)["fft4d"] == "same"
    assert found.curves["p_worse"].min() == 2.0**-9  # one of ten trials' sign flips, at half the level


def test_p_values_are_those_of_signed_ranks_corrected_by_hand(two_runs):
    def change(records):
        records["deviation"] += np.random.default_rng(2).normal(0.2, 0.3, len(records))

    base, new = two_runs(change, trials=16)
    found = compare_tables(base, new)
    pivot = [
        run.rows.pivot_table(index="trial", columns=["estimator", "snr_db"], values="deviation")
        for run in (base, new)
    ]
    differences = pivot[1] - pivot[0]
    for table, columns in (
        (found.points, differences),
        (found.curves, differences.T.groupby(level=0).mean().T),
    ):
        raw = [wilcoxon(columns[key], alternative="greater", method="exact").pvalue for key in columns]
        by_hand = np.array(raw)
        order = np.argsort(by_hand)
        by_hand[order] = np.maximum.accumulate(by_hand[order] * np.arange(len(raw), 0, -1)) * 2
        np.testing.assert_allclose(
            table.sort_values(["estimator", *(["snr_db"] if "snr_db" in table else [])])["p_worse"],
            np.minimum(by_hand, 1),
        )


@pytest.mark.parametrize(
    ("curves", "points", "shares"),
    [
        ([2.0**-10] * 4, [2.0**-10] * 44, (1, 0)),
        ([2.0**-20] * 4, [2.0**-20] * 44, (0.5, 0.5)),
        ([2.0**-2] * 4, [2.0**-2] * 44, (1, 0)),
        ([], [], (1, 0)),
        ([2.0**-5], [2.0**-9], (0, 1)),
    ],
)
def test_a_family_that_can_show_nothing_leaves_its_half_of_the_level(curves, points, shares):
    assert share_level(np.array(curves), np.array(points), 0.01) == shares


def test_the_mean_of_a_trial_takes_its_paired_snrs_alone(two_runs):
    def change(records):
        records.loc[(records["trial"] == 3) & (records["snr_db"] == -5), "status"] = "error"
        records.loc[records["estimator"] == "music2d", "deviation"] += 1.0

    found = compare_tables(*two_runs(change))
    (row,) = found.curves[found.curves["estimator"] == "music2d"].to_dict("records")
    assert row["change"] == pytest.approx(1.0)
    counts = found.points.set_index(["estimator", "snr_db"])["n_pairs"]
    assert counts["music2d", -5] == 9
    assert counts["music2d", 10] == 10


def test_changes_that_cancel_over_the_snrs_leave_the_curve_as_it_was(two_runs):
    def change(records):
        records.loc[records["snr_db"] == -20, "deviation"] += 0.1
        records.loc[records["snr_db"] == 10, "deviation"] -= 0.1

    found = compare_tables(*two_runs(change))
    assert (found.curves["change"] == 0).all()
    assert (found.curves["p_worse"] == 1).all()
    assert found.points["change"].abs().max() == pytest.approx(0.1)


def test_a_curve_of_one_snr_is_tested_once(two_runs):
    found = compare_tables(*two_runs(scaled(1.2), snr_db=[0], trials=7))
    assert verdicts(found.curves)["music2d"] == verdicts(found.points)["music2d"] == "regression"
    assert found.curves["p_worse"].min() == found.points["p_worse"].min() == 2.0**-7


def test_new_failures_are_a_regression_repaired_ones_are_told(two_runs):
    statuses = ["error", "skipped"]

    def change(records):
        records.loc[[5, 6], "status"] = statuses
        records.loc[[5, 6], "reason"] = "ValueError: no"
        records.loc[[5, 6], "deviation"] = np.nan

    base, new = two_runs(change)
    found = compare_tables(base, new)
    assert found.is_regression
    failures = found.changed_cells("failed")[["status", "reason"]].to_numpy().tolist()
    assert sorted(failures) == [[status, "ValueError: no"] for status in statuses]
    assert found.n_paired == len(base.rows) - 2
    back = compare_tables(new, base)
    assert not back.is_regression
    assert sorted(back.changed_cells("repaired")["status"]) == statuses


def test_nothing_detected_is_delivered_and_what_failed_in_both_is_left_out(two_runs):
    def change(records):
        records.loc[0, "status"] = "no_detection"
        records.loc[1, "status"] = "error"

    base, new = two_runs(change)
    base.rows.loc[1, "status"] = "timeout"
    found = compare_tables(base, new)
    assert not found.is_regression
    assert (list(found.cells["change"]), found.n_paired) == (["failed_both"], len(base.rows) - 1)


def test_a_missing_cell_is_a_regression_an_added_one_is_told(two_runs):
    base, new = two_runs()
    shorter = Run("new", new.rows.iloc[:-2], new.manifest)
    found = compare_tables(base, shorter)
    assert found.is_regression
    assert list(found.cells["change"]) == ["missing"] * 2
    back = compare_tables(shorter, base)
    assert not back.is_regression
    assert list(back.cells["change"]) == ["added"] * 2


def test_rows_in_another_order_or_as_categories_are_paired_alike(two_runs):
    base, new = two_runs(scaled(1.1, spread=0.05))
    shuffled = new.rows.sample(frac=1, random_state=0)
    texts = ["scenario", "estimator", "params", "status", "reason", "environment", "scenario_content"]
    categories = shuffled.astype(dict.fromkeys(texts, "category"))
    found, expected = (
        compare_tables(base, run).points.sort_values([*KEYS, "snr_db"], ignore_index=True)
        for run in (Run("new", categories, new.manifest), new)
    )
    pd.testing.assert_frame_equal(found, expected.astype({"params": object}), check_dtype=False)


def test_points_without_scores_by_design_are_left_out(two_runs):
    def change(records):
        records.loc[records["estimator"] == "fft4d", "deviation"] = np.nan

    base, new = two_runs(change)
    change(base.rows)
    found = compare_tables(base, new)
    assert set(found.curves["estimator"]) == {"music2d"}
    assert not found.notes
    for run in (base, new):
        run.rows["deviation"] = np.nan
    empty = compare_tables(base, new)
    assert len(empty.curves) == len(empty.points) == 0
    assert empty.notes == ("deviation: no cell of both sides has one, nothing compared",)


def test_scores_that_disappear_are_told_and_a_regression(two_runs):
    def lose(records):
        records.loc[records["estimator"] == "fft4d", "deviation"] = np.nan

    found = compare_tables(*two_runs(lose))
    assert verdicts(found.points)["fft4d"] == "inconclusive"
    assert found.notes[0].startswith("deviation: 30 cells that have one in the base alone, and 0")
    assert found.n_lost_scores == 30
    assert found.is_regression
    assert "30 scores missing in the new run" in ComparisonReport(found).summary()


def test_higher_is_better_where_the_metric_says_so(two_runs):
    def change(records):
        records["recall"] -= 0.1

    base, new = two_runs(change, trials=12)
    found = compare_tables(base, new, [parse_tolerance("recall=5%")])
    assert set(found.curves.loc[found.curves["metric"] == "recall", "verdict"]) == {"regression"}
    assert set(found.curves.loc[found.curves["metric"] == "deviation", "verdict"]) == {"same"}
    assert not compare_tables(new, base, [parse_tolerance("recall=5%")]).is_regression


def test_shares_of_yes_and_no_are_compared_and_a_score_of_zero_may_not_grow_by_any_per_cent(two_runs):
    base, new = two_runs(trials=20)
    is_fft4d = new.rows["estimator"] == "fft4d"
    base.rows["resolved"], base.rows["velocity_nmse"] = True, 0.0
    new.rows["resolved"], new.rows["velocity_nmse"] = is_fft4d, np.where(is_fft4d, 0.0, 1e-3)
    tolerances = [Tolerance("resolved", 0.1, is_relative=False), parse_tolerance("velocity_nmse=50%")]
    found = compare_tables(base, new, tolerances)
    for metric in ("resolved", "velocity_nmse"):
        chosen = found.curves[found.curves["metric"] == metric]
        assert verdicts(chosen) == {"fft4d": "same", "music2d": "regression"}


def test_run_time_is_compared_between_timed_rows_of_equal_machines_and_else_told_why_not(two_runs):
    def slower(records):
        records["time_estimate_s"] *= 1.5

    base, new = two_runs(slower, trials=12)
    time = [parse_tolerance("time_estimate_s=10%")]
    base.rows["timing"] = True
    found = compare_tables(base, new, time)
    assert not found.is_regression
    assert found.notes[0] == (
        "time_estimate_s: 0 of 72 paired cells compared; 72 were not timed "
        "(alone, serially, one BLAS thread) on both sides"
    )
    new.rows["timing"] = True
    new.manifest["environments"] = {"e2": new.manifest["environments"]["e1"]}
    new.rows["environment"] = pd.Categorical(["e2"] * len(new.rows))
    found = compare_tables(base, new, time)
    assert found.is_regression
    assert not found.notes
    for key, value in (("processor", "Q"), ("cores", 4)):
        new.manifest["environments"]["e2"]["machine"] = {"processor": "P", "cores": 2, key: value}
        found = compare_tables(base, new, time)
        assert not found.is_regression
        assert "72 ran on other machines (P, 2 cores, and" in found.notes[0]


def test_differing_code_is_what_comparing_is_for_and_is_told(two_runs):
    base, new = two_runs()
    new.manifest["git"] = {"commit": "fedcba9876543210", "dirty": True}
    for run, version in ((base, "1.0"), (new, "2.0")):
        run.manifest["environments"]["e1"]["versions"] = {"numpy": version, "python": "3.11"}
    found = compare_tables(base, new)
    assert found.base_version == "0.1.0 (0123456789)"
    assert found.new_version == "0.1.0 (fedcba9876, changed)"
    assert found.notes == ("made by other versions: numpy 2.0 instead of 1.0",)
    new.manifest["git"] = None
    assert code_version(new.manifest) == "0.1.0"


def test_everything_that_forbids_a_comparison_is_told_at_once(two_runs):
    base, new = two_runs()
    new.manifest.update(
        {
            "suite": {"name": "town", "kind": "detection"},
            "seed": 1,
            "scores": {"metrics": {"paper": {"version": 2, "params": {}}}},
            "scenarios": {"street": {"content": "other"}, "yard": {"content": "y"}},
        }
    )
    with pytest.raises(NotComparableError) as caught:
        compare_tables(base, new)
    assert caught.value.reasons == (
        "the suite differs: street in base, town in new",
        "the kind of suite differs: imaging in base, detection in new",
        "the seed differs: 0 in base, 1 in new",
        "the metric paper differs: version 1 in base, version 2 in new",
        "scenario street has another content",
    )
    base, new = two_runs()
    new.rows.loc[3, "scenario_content"] = "edited"
    with pytest.raises(NotComparableError, match="scenario street has another content"):
        compare_tables(base, new)


def test_what_cannot_be_asked_is_refused(two_runs):
    runs = two_runs()
    refused = [
        ({"alpha": 0}, "alpha = 0: allowed is"),
        ({"alpha": 0.5}, "allowed is a number above 0 and below 0.5"),
        ({"tolerances": [Tolerance("trial", 0.1, True)]}, "unknown score 'trial'"),
        ({"tolerances": [Tolerance("timing", 0.1, True)]}, "allowed are deviation, recall, time_estimate_s"),
    ]
    for options, message in refused:
        with pytest.raises(InputError, match=message):
            compare_tables(*runs, **options)


def variant(records, name, params, **change):
    """Records in which an estimator has parameters, and perhaps another name."""
    chosen = records["estimator"] == name
    records = records.copy()
    for column, value in {"params": params, **change}.items():
        records.loc[chosen, column] = value
    return records


OLD, NEW = '{"n":1,"pfa":0.001}', '{"m":2,"n":1,"pfa":0.0001}'
NUMBERS = ["base_mean", "new_mean", "relative_low", "p_worse", "smallest_effect", "verdict"]


@pytest.fixture
def retuned(made_run, written_run):
    """Write a run, and one in which music2d has other parameters and is worse."""
    records, manifest = made_run(trials=12)
    worse = records["deviation"].where(records["estimator"] != "music2d", records["deviation"] * 1.2)
    base = written_run("base", variant(records, "music2d", OLD), manifest)
    return base, written_run("new", variant(records.assign(deviation=worse), "music2d", NEW), manifest)


def test_estimators_that_are_paired_are_compared_as_if_nothing_else_had_changed(retuned, two_runs):
    expected = compare_tables(*two_runs(scaled(1.2), trials=12))
    found = compare(*retuned, map="music2d[pfa=1e-3]=music2d")
    pd.testing.assert_frame_equal(found.curves[NUMBERS], expected.curves[NUMBERS])
    pd.testing.assert_frame_equal(found.points[NUMBERS], expected.points[NUMBERS])
    (row,) = found.curves[found.curves["estimator"] == "music2d"].to_dict("records")
    assert (row["params"], row["new_estimator"], row["new_params"]) == (OLD, "music2d", NEW)
    assert found.cells.empty
    assert not found.notes


def test_without_a_map_cells_under_other_parameters_are_missing_and_the_options_that_pair_them_named(retuned):
    found = compare(*retuned)
    assert found.is_regression
    assert found.cells["change"].value_counts().to_dict() == {"missing": 36, "added": 36}
    (note,) = found.notes
    assert note.startswith("music2d ran with other parameters")
    assert note.endswith("; --map pairs them")


def test_a_variant_whose_equal_is_paired_with_another_is_neither_missing_nor_added_but_told(
    made_run, written_run
):
    runs = [written_run(name, *made_run()) for name in ("base", "new")]
    found = compare(*runs, map="music2d=fft4d")
    assert found.curves[["estimator", "new_estimator"]].to_numpy().tolist() == [["music2d", "fft4d"]]
    assert found.cells.empty
    assert [note.partition(" is left out")[0] for note in found.notes] == [
        f"fft4d of {runs[0]}",
        f"music2d of {runs[1]}",
    ]


def test_cells_of_a_pair_that_one_side_lacks_are_told_under_both_names(two_runs):
    base, new = two_runs()
    first = new.rows.index[new.rows["estimator"] == "music2d"][0]
    shorter = Run("new", new.rows.drop(index=first), new.manifest)
    partners = {("fft4d", "{}"): ("music2d", "{}")}
    (cell,) = compare_tables(base, shorter, partners=partners).changed_cells("missing").to_dict("records")
    assert (cell["estimator"], cell["new_estimator"]) == ("fft4d", "music2d")


def test_pairs_that_cannot_be_are_refused(retuned):
    refused = [
        ({"map": ["music2d=fft4d", "music2d=music2d"]}, "base: 'music2d' is paired twice"),
        ({"map": ["fft4d=music2d", "music2d=music2d"]}, "new: 'music2d' is paired twice"),
    ]
    for asked, message in refused:
        with pytest.raises(InputError, match=message):
            compare(*retuned, **asked)
    with pytest.raises(InputError, match=r"'music2d' and 'music2d\[n=1\]' name the same estimator"):
        compare(retuned[0], between=("music2d", "music2d[n=1]"))


def test_two_estimators_of_a_run_are_compared_as_two_runs_are(retuned, two_runs):
    found = compare(retuned[1], between=("fft4d", "music2d[m=2]"))
    base, new = two_runs(scaled(1.2), trials=12)
    of_one = Run("a", base.rows[base.rows["estimator"] == "fft4d"], base.manifest)
    other = new.rows[new.rows["estimator"] == "music2d"].assign(estimator="fft4d")
    expected = compare_tables(of_one, Run("b", other, new.manifest))
    pd.testing.assert_frame_equal(found.curves[NUMBERS], expected.curves[NUMBERS])
    pd.testing.assert_frame_equal(found.points[NUMBERS], expected.points[NUMBERS])
    assert found.is_regression
    assert found.between == (("fft4d", "{}"), ("music2d", NEW))


def test_between_two_estimators_a_cell_that_the_second_alone_fails_is_a_new_failure(made_run, written_run):
    records, manifest = made_run()
    first = records.index[records["estimator"] == "fft4d"][0]
    records.loc[first, ["status", "reason"]] = ["timeout", "9 s"]
    run = written_run("run", records, manifest)
    found = compare(run, between=("music2d", "fft4d"), tolerances="deviation=1000%")
    assert found.changed_cells("failed")[["status", "reason"]].to_numpy().tolist() == [["timeout", "9 s"]]
    assert found.is_regression
    assert len(compare(run, between=("fft4d", "music2d")).changed_cells("repaired")) == 1


def test_code_of_estimators_with_different_names_is_no_other_version(made_run):
    records, manifest = made_run()
    records.loc[records["estimator"] == "music2d", "environment"] = "e2"
    machine = manifest["environments"]["e1"]["machine"]
    for name, versions in (
        ("e1", {"numpy": "2.0", "plugins": {"a": {"version": "1"}}, "isacbench": {"digest": "a"}}),
        ("e2", {"numpy": "2.1", "plugins": {"b": {"version": "2"}}, "isacbench": {"digest": "b"}}),
    ):
        manifest["environments"][name] = {"machine": machine, "versions": versions}
    run = Run("run", records, manifest)
    found = compare_tables(run, run, partners={("fft4d", "{}"): ("music2d", "{}")}, is_between=True)
    assert found.notes == ("made by other versions: numpy 2.1 instead of 2.0",)


def test_a_comparison_shows_itself_in_three_lines_and_changes_nothing_on_disk(retuned):
    before = [(path, path.stat().st_mtime_ns) for folder in retuned for path in sorted(folder.iterdir())]
    shown = repr(compare(*map(str, retuned), map="music2d=music2d")).split("\n")
    assert shown[0].endswith("/new': regression")
    assert shown[1:] == [
        " curves: 1 regression, 1 same; points: 3 regression, 3 same",
        " cells: 72 paired, 0 failed anew, 0 missing>",
    ]
    after = [(path, path.stat().st_mtime_ns) for folder in retuned for path in sorted(folder.iterdir())]
    assert after == before


@pytest.mark.slow
@pytest.mark.parametrize("trials", [6, 12])
def test_of_unchanged_code_no_more_regressions_are_reported_than_alpha_says(made_run, trials):
    records, manifest = made_run(trials=trials, snr_db=[-20, -10, 0, 10])
    rng, exact, n_false = np.random.default_rng(0), [Tolerance("deviation", 0.0, False)], 0
    for _ in range(400):
        # Heavy tails, and trials that share noise over SNRs.
        trial_noise = rng.standard_t(3, (2, trials))[:, records["trial"]]
        noise = trial_noise + 0.5 * rng.standard_t(3, (2, len(records)))
        base, new = (Run("run", records.assign(deviation=20 + part), manifest) for part in noise)
        n_false += compare_tables(base, new, exact, alpha=0.1).is_regression
    assert n_false <= binom.ppf(0.999, 400, 0.1)
    assert n_false >= 4  # a test that never rejects would prove nothing


@given(st.floats(0, 1000), st.booleans())
def test_what_is_written_is_read_back(limit, is_relative):
    written = Tolerance("chamfer_m", limit, is_relative)
    read = parse_tolerance(str(written))
    assert (read.metric, read.is_relative) == ("chamfer_m", is_relative)
    assert math.isclose(read.limit, limit, rel_tol=1e-5, abs_tol=1e-300)


@pytest.mark.parametrize("text", ["a=5%", " a = 5 % ", "a=5e0%"])
def test_spaces_and_powers_of_ten_are_allowed(text):
    assert parse_tolerance(text) == Tolerance("a", 0.05, True)


@pytest.mark.parametrize(
    "text",
    ["", "deviation", "deviation=", "=5%", "a=-1%", "a=nan", "a=5%%", "a b=1", "a=1 2", "a=１", "a=1_0"],
)
def test_anything_else_is_refused_and_quoted(text):
    with pytest.raises(InputError, match="allowed is NAME=NUMBER%") as caught:
        parse_tolerance(text)
    assert repr(text) in str(caught.value)


def test_the_deviation_is_always_compared_and_the_last_word_counts():
    assert merge_tolerances([]) == (DEFAULT_TOLERANCE,)
    given_twice = [Tolerance("deviation", 1.0, False), Tolerance("a", 1, True), Tolerance("a", 2, True)]
    assert merge_tolerances(given_twice) == (given_twice[0], given_twice[2])


@pytest.mark.parametrize(
    ("column", "better"),
    [
        ("deviation", "lower"),
        ("recall", "higher"),
        ("resolved", "higher"),
        ("n_hits", "higher"),
        ("own", "lower"),
    ],
)
def test_directions_are_those_of_the_metric_and_lower_for_unknown_columns(column, better):
    assert direction(column, DESCRIBED, [column]) == better


@pytest.mark.parametrize("column", ["n_true", "n_estimated", "bound_u", "pfa", "seed", "timing"])
def test_what_has_no_better_direction_is_refused(column):
    with pytest.raises(InputError, match=f"{column} has no better direction; allowed are own"):
        direction(column, DESCRIBED, [column, "own"])
