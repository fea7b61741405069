import pandas as pd

RUN = ("run", "quick", "-s", "tiny.toml", "-e", "blob", "-e", "seer", "--snr", "0,5", "-n", "4")


def test_merge_says_what_is_missing_if_anything_is_and_rescore_tells_what_changed(cli):
    for k in (1, 2):
        assert cli(*RUN, "--shard", f"{k}/2", "-o", k).exit_code == 0
    result = cli("merge", "1", "-o", "half")
    assert result.exit_code == 0, result.output
    assert result.stderr == ""
    lines = result.stdout.splitlines()
    start = lines.index("half: 8 of 16 cells")
    assert [line.partition(" {")[0] for line in lines[start + 1 :]] == [
        "missing: 4 cells of blob on tiny, trials 1, 3",
        "missing: 4 cells of seer on tiny, trials 1, 3",
    ]
    assert lines[start + 1].endswith("on tiny, trials 1, 3")
    assert lines[start - 1] == "half: summary.csv, summary.md, deviation.png"
    assert len(pd.read_parquet("half/results.parquet")) == 8
    result = cli("merge", "2", "1", "-o", "all")
    assert result.stdout.splitlines()[-1] == "all: 16 of 16 cells"
    assert cli("report", "all").exit_code == 0

    before = pd.read_parquet("all/results.parquet")
    wrong = before.copy()
    wrong.attrs = {}
    wrong.loc[[1, 4], "deviation"] += [0.5, -0.25]
    wrong.to_parquet("all/results.parquet", index=False)
    result = cli("rescore", "all")
    assert result.exit_code == 0, result.output
    assert result.stdout.splitlines()[-2:] == [
        "all: 16 rows scored again, 2 of them differ",
        "deviation: 2 rows, by at most 0.5",
    ]
    pd.testing.assert_frame_equal(pd.read_parquet("all/results.parquet"), before)
    again = cli("rescore", "all")
    assert again.stdout.splitlines()[-1] == "all: 16 rows scored again, 0 of them differ"


def test_many_gaps_are_counted(cli):
    names = [word for n in range(1, 13) for word in ("-e", f"blob[n={n}]")]
    cli("run", "quick", "-s", "tiny.toml", *names, "--snr", "0", "-n", "2", "--shard", "1/2", "-o", "1")
    lines = cli("merge", "1", "-o", "all").stdout.splitlines()
    assert lines[-12] == "all: 12 of 24 cells"
    assert lines[-1] == "missing: and of 2 more"


def test_a_folder_that_is_none_ends_in_one_message(cli, tmp_path):
    for words in ("merge gone -o all", "rescore gone"):
        result = cli(*words.split())
        assert result.exit_code == 2, words
        message = "isacbench: gone: not the folder of a run, manifest.json missing"
        assert result.stderr.startswith(message)
        assert result.stderr.count("\n") == 1, words
        assert not list(tmp_path.glob("all")) + list(tmp_path.glob("gone")), words
