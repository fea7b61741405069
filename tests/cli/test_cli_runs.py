"""Runs that go on timed, are compared, merged and scored again."""

import shutil

import pandas as pd

from isacbench.bench.cells.rows import TIMING_COLUMNS

RUN = ("run", "quick", "-s", "tiny.toml", "-e", "blob", "--snr", "0", "-n", 3)


def test_a_folder_goes_on_timed_is_compared_and_goes_on_without(cli):
    assert cli(*RUN, "-o", "out").exit_code == 0
    timed = cli(*RUN, "--timing", "--repeats", 2, "-o", "out")
    assert timed.exit_code == 0, timed.output
    assert "tiny: median processor time of an estimate and its stages [ms], peak memory [MiB]" in timed.stdout
    assert "out: summary.csv, summary.md, stages.csv, stages.md, " in timed.stdout
    assert pd.read_parquet("out/results.parquet")["timing"].all()

    shutil.copytree("out", "new")
    compared = cli("compare", "out", "new", "--tolerance", "time_estimate_s=1000000%", "--json")
    assert compared.exit_code == 0, compared.output
    assert '"time_estimate_s"' in compared.stdout
    assert "not timed" not in compared.stdout

    assert "stages.md" in cli(*RUN[:-1], 4, "-o", "out").stdout
    records = pd.read_csv("out/results.csv")
    assert (records["timing"] == (records["trial"] < 3)).all()
    assert set(TIMING_COLUMNS) <= set(records)
    assert "stages.md" in cli("report", "out").stdout
    assert "0 of them differ" in cli("rescore", "out").stdout


def test_merge_says_what_is_missing_if_anything_is_and_rescore_tells_what_changed(cli, monkeypatch):
    for k in (1, 2):
        assert cli(*RUN[:-1], 4, "-e", "seer", "--shard", f"{k}/2", "-o", k).exit_code == 0
    result = cli("merge", "1", "-o", "half")
    assert result.exit_code == 0, result.output
    assert result.stderr == ""
    lines = result.stdout.splitlines()
    start = lines.index("half: 4 of 8 cells")
    assert [line.partition(" {")[0] for line in lines[start + 1 :]] == [
        "missing: 2 cells of blob on tiny, trials 1, 3",
        "missing: 2 cells of seer on tiny, trials 1, 3",
    ]
    assert lines[start - 1] == "half: summary.csv, summary.md, deviation.png"
    assert len(pd.read_parquet("half/results.parquet")) == 4
    monkeypatch.setattr("isacbench.cli.result_commands.GAPS_SHOWN", 1)
    lines = cli("merge", "1", "-o", "again").stdout.splitlines()
    assert lines[-2].startswith("missing: 2 cells of blob")
    assert lines[-1] == "missing: and of 1 more"
    result = cli("merge", "2", "1", "-o", "all")
    assert result.stdout.splitlines()[-1] == "all: 8 of 8 cells"
    assert cli("report", "all").exit_code == 0

    before = pd.read_parquet("all/results.parquet")
    wrong = before.copy()
    wrong.attrs = {}
    wrong.loc[[1, 4], "deviation"] += [0.5, -0.25]
    wrong.to_parquet("all/results.parquet", index=False)
    result = cli("rescore", "all")
    assert result.exit_code == 0, result.output
    assert result.stdout.splitlines()[-2:] == [
        "all: 8 rows scored again, 2 of them differ",
        "deviation: 2 rows, by at most 0.5",
    ]
    pd.testing.assert_frame_equal(pd.read_parquet("all/results.parquet"), before)
    again = cli("rescore", "all")
    assert again.stdout.splitlines()[-1] == "all: 8 rows scored again, 0 of them differ"
