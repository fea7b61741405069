import re

import numpy as np
import pandas as pd
import pytest

import isacbench
from isacbench.bench.compare.ranking import rank_table
from isacbench.bench.compare.scenes import scene_groups
from isacbench.bench.compare.significance import bootstrap_changes
from isacbench.errors import InputError

ALL = "all scenes"
PAIR = ("fft4d", "music2d")


@pytest.fixture
def run(scenes_run):
    """Return a run over eight scenes."""
    return scenes_run(town=8)


@pytest.fixture
def ranked(run, remembered):
    """Return its ranking."""
    if "ranking" not in remembered:
        remembered["ranking"] = rank_table(run, "deviation")
    return remembered["ranking"]


def of(table, estimator, group=ALL, **equal):
    rows = table[(table["estimator"] == estimator) & (table["group"] == group)]
    for name, value in equal.items():
        rows = rows[rows[name] == value]
    (row,) = rows.to_dict("records")
    return row


def fail(records, estimator, scenario, **equal):
    """Make the cells of an estimator in a scene fail."""
    chosen = (records["estimator"] == estimator) & (records["scenario"] == scenario)
    for name, value in equal.items():
        chosen &= records[name] == value
    hausdorff = [f"hausdorff_{what}_m" for what in ("xy", "xz", "yz", "sum")]
    scores = ["deviation", "precision", "recall", *hausdorff]
    records.loc[chosen, scores] = np.nan
    records.loc[chosen, "status"] = "timeout"


def test_scores_of_scenes_are_means_and_the_worst_are_listed_with_their_worst_cell(scenes_run):
    run = scenes_run(town=8, trials=2)
    found = rank_table(run, "deviation")
    scores, own = found.scores["music2d", "{}"], run.rows[run.rows["estimator"] == "music2d"]
    means = own.groupby("scenario")["deviation"].mean()
    assert scores.to_dict() == pytest.approx(means.to_dict())
    assert of(found.ranks, "music2d")["mean"] == pytest.approx(scores.mean())
    worst = found.worst[found.worst["estimator"] == "music2d"]
    assert worst["scenario"].tolist() == scores.sort_values(ascending=False).index[:3].tolist()
    row = worst.iloc[0]
    place = own.loc[own.loc[own["scenario"] == row["scenario"], "deviation"].idxmax()]
    assert (row["snr_db"], row["trial"]) == (place["snr_db"], place["trial"])


def test_more_trials_of_a_scene_are_no_more_scenes(run, ranked):
    copies = [run.rows.assign(trial=trial) for trial in range(2)]
    many = rank_table(run.changed(rows=pd.concat(copies, ignore_index=True)), "deviation")
    pd.testing.assert_frame_equal(many.ranks, ranked.ranks)
    pd.testing.assert_frame_equal(many.wins, ranked.wins)


def test_estimators_are_sorted_best_first_and_references_stand_beside_without_a_rank(ranked):
    ranks = ranked.ranks
    assert ranks["estimator"].tolist() == ["fft4d", "music2d", "esprit2d", "oracle"]
    assert ranks["is_reference"].tolist() == [False, False, False, True]
    assert ranks["rank_low"].tolist()[:3] == [1, 2, 3]
    assert ranks["rank_low"].isna().tolist() == [False, False, False, True]
    oracle = of(ranks, "oracle")
    assert oracle["mean"] > ranks["mean"].iloc[2]  # the made-up one is the worst
    assert 0 < oracle["f_score"] < 1


def test_a_score_whose_better_direction_is_up_is_ranked_from_above(scenes_run):
    found = rank_table(scenes_run(town=8), "precision")
    assert found.better == "higher"
    assert found.ranks["estimator"].tolist()[:3] == ["fft4d", "music2d", "esprit2d"]
    assert of(found.ranks, "fft4d")["rank_high"] == 1
    assert of(found.wins, "fft4d", other="esprit2d")["probability"] == 1


def test_wins_are_the_shares_of_scenes_in_plain_loops_and_ties_count_half(scenes_run):
    def tie(records):
        chosen = (records["scenario"] == "town[seed=0]") & (records["estimator"] != "oracle")
        records.loc[chosen, "deviation"] = 7.0

    run = scenes_run(tie, town=10, estimators=("a", "b", "c"))
    run.rows["deviation"] += np.random.default_rng(0).normal(0, 3, len(run.rows)) * (
        run.rows["scenario"] != "town[seed=0]"
    )
    found = rank_table(run, "deviation")
    for one, other in [("a", "b"), ("b", "a"), ("c", "a")]:
        first, second = found.scores[one, "{}"], found.scores[other, "{}"]
        wins = sum(1.0 if x < y else 0.5 if x == y else 0.0 for x, y in zip(first, second, strict=True))
        row = of(found.wins, one, other=other)
        assert row["probability"] == wins / 10
        assert row["n_ties"] == 1
        assert row["low"] < row["probability"] < row["high"]
        expected = bootstrap_changes(second.to_numpy()[:, None], first.to_numpy()[:, None])
        assert row["change"] == pytest.approx(expected["change"].iloc[0])
        assert row["change_low"] == pytest.approx(expected["change_low"].iloc[0])


def test_a_failed_cell_counts_as_the_worst_score_of_the_run_and_never_flatters(scenes_run, run, ranked):
    hard = "town[seed=3]"
    found = rank_table(
        scenes_run(lambda records: fail(records, "fft4d", hard, snr_db=10), town=8), "deviation"
    )
    rows = run.rows[run.rows["estimator"] != "oracle"]
    worst = rows["deviation"].max()
    left = rows[(rows["scenario"] == hard) & (rows["estimator"] == "fft4d") & (rows["snr_db"] == -10)]
    assert found.scores.loc[hard, ("fft4d", "{}")] == pytest.approx((worst + left["deviation"].iloc[0]) / 2)
    others = found.scores.drop(columns=[("fft4d", "{}")])
    pd.testing.assert_frame_equal(others, ranked.scores[others.columns])
    assert of(found.ranks, "fft4d")["mean"] > of(ranked.ranks, "fft4d")["mean"]
    assert any("failed cells of fft4d: 1" in note for note in found.notes)


def test_a_cell_at_which_an_estimator_has_no_row_is_left_out_for_all_and_told(run):
    gone = (run.rows["estimator"] == "fft4d") & (run.rows["scenario"] == "town[seed=1]")
    found = rank_table(run.changed(rows=run.rows[~gone]), "deviation")
    assert "town[seed=1]" not in found.scores.index
    assert len(found.scores) == 7
    assert any("2 of 16 combinations" in note and "1 scene " in note for note in found.notes)


def test_families_with_twenty_scenes_get_ranks_of_their_own(scenes_run):
    found = rank_table(scenes_run(town=20, crowd=19, estimators=PAIR))
    assert found.ranks["group"].unique().tolist() == [ALL, "town scenes"]
    assert set(found.ranks.loc[found.ranks["group"] == "town scenes", "n_scenes"]) == {20}
    town = found.scores[[name.startswith("town") for name in found.scores.index]]
    assert of(found.ranks, "fft4d", "town scenes")["mean"] == pytest.approx(town["fft4d", "{}"].mean())
    assert scene_groups(["a"] * 3, {}) == {ALL: ["a"]}


def test_the_ratio_is_to_the_oracle_and_not_formed_for_lone_scatterers(scenes_run):
    found = rank_table(scenes_run(town=7, sparse=7), "ratio")
    assert {name.partition("[")[0] for name in found.scores.index} == {"town"}
    assert of(found.ranks, "oracle")["mean"] == 1
    with pytest.raises(InputError, match="in no scene do all estimators have a ratio"):
        rank_table(scenes_run(sparse=9), "ratio")


def test_an_estimator_that_always_failed_has_no_scores_beside(scenes_run):
    names = [f"town[seed={seed}]" for seed in range(8)]

    def fail_all(records):
        records["velocity_error_mps"] = 0.5
        for name in names:
            fail(records, "fft4d", name)

    ranks = rank_table(scenes_run(fail_all, town=8, estimators=PAIR)).ranks
    assert np.isnan(of(ranks, "fft4d")["f_score"])
    assert np.isnan(of(ranks, "fft4d")["velocity_error_mps"])
    assert of(ranks, "music2d")["velocity_error_mps"] == 0.5


def test_counts_of_lone_scatterers_rank_over_scenes_of_lone_scatterers_alone(scenes_run):
    def count(records):
        lone = records["scenario"].str.startswith("sparse")
        records["n_resolvable"] = records["n_resolved"] = records["n_false"] = np.where(lone, 3, 0)

    found = rank_table(scenes_run(count, town=7, sparse=7, estimators=PAIR), "n_false")
    assert {name.partition("[")[0] for name in found.scores.index} == {"sparse"}


def test_scenarios_that_are_no_scenes_are_not_ranked_over(run):
    run.manifest["suite"]["kind"] = "resolution"
    with pytest.raises(
        InputError, match=r"kind 'resolution' are no scenes to rank over; allowed are .* imaging"
    ):
        rank_table(run)


def test_variants_of_one_estimator_are_ranked_apart(scenes_run):
    run = scenes_run(town=8, estimators=("blob", "fft4d"))
    better = run.rows[run.rows["estimator"] == "blob"].assign(params='{"n":2}')
    better["deviation"] -= 1
    first = run.rows.assign(params=np.where(run.rows["estimator"] == "blob", '{"n":1}', "{}"))
    found = rank_table(run.changed(rows=pd.concat([first, better], ignore_index=True)), "deviation")
    assert [found.labels[key] for key in found.scores.columns] == ["blob[n=1]", "fft4d", "blob[n=2]"]
    assert found.ranks["params"].tolist() == ['{"n":2}', '{"n":1}', "{}"]


def test_too_few_estimators_are_refused_in_words(scenes_run):
    with pytest.raises(InputError, match=r"two estimators or more .* the run has fft4d"):
        rank_table(scenes_run(town=8, estimators=("fft4d", "oracle")))


def test_fewer_than_six_scenes_have_means_and_differences_and_no_ranks(scenes_run):
    found = rank_table(scenes_run(town=3), "deviation")
    assert found.is_descriptive
    assert found.ranks["rank_low"].isna().all()
    own = found.ranks[~found.ranks["is_reference"]]
    assert own["mean"].tolist() == sorted(own["mean"])
    assert own["change"].tolist() == pytest.approx((own["mean"] - own["mean"].iloc[0]).tolist())
    assert own["change_low"].iloc[1:].isna().all()


def test_the_default_is_the_ratio_and_without_an_oracle_the_hausdorff_sum(scenes_run):
    assert rank_table(scenes_run(town=8)).metric == "ratio"
    assert rank_table(scenes_run(town=8, estimators=("fft4d", "music2d"))).metric == "hausdorff_sum_m"


def test_a_subset_is_ranked_by_itself_and_a_reference_is_refused(scenes_run):
    run = scenes_run(town=8)
    found = rank_table(run, "deviation", ["fft4d", "esprit2d"])
    assert {name for name, _ in found.scores.columns} == {"fft4d", "esprit2d"}
    assert "oracle" in set(found.ranks["estimator"])
    with pytest.raises(InputError, match="oracle is a reference and is not ranked"):
        rank_table(run, "deviation", ["oracle", "fft4d"])
    with pytest.raises(InputError, match=r"two estimators or more .* chosen: fft4d"):
        rank_table(run, "deviation", ["fft4d"])


def test_a_rival_that_fails_at_times_widens_the_sets_of_all_and_is_named(scenes_run):
    def fail_at_times(records):
        chosen = records["estimator"] == "c"
        records.loc[chosen, "deviation"] = 6.0
        records.loc[chosen & records["scenario"].isin(["town[seed=1]", "town[seed=7]"]), "deviation"] = 90.0

    run = scenes_run(fail_at_times, town=20, estimators=("a", "b", "c"))
    (note,) = [one for one in rank_table(run, "deviation").notes if "critical value" in one]
    assert re.match(
        r"all scenes: the width of the rank sets is set by (c against [ab]|[ab] against c), ", note
    )
    assert "-e ranks a subset that was chosen before looking" in note


def test_a_metric_that_the_run_has_not_is_refused_with_those_it_has(run):
    with pytest.raises(InputError, match=r"deviatoin.*deviation"):
        rank_table(run, "deviatoin")
    with pytest.raises(InputError, match="no better direction"):
        rank_table(run, "n_estimated")


def test_a_folder_is_ranked_as_its_table_is(run, ranked, written_run):
    folder = written_run("r", run.rows, run.manifest)
    found = isacbench.rank(folder, "deviation")
    pd.testing.assert_frame_equal(found.ranks[ranked.ranks.columns], ranked.ranks)
    assert repr(found).splitlines()[1] == " fft4d: 1"
