import pandas as pd
import pytest
from typer.testing import CliRunner

from isacbench.cli import app

RUN = ("run", "quick", "-s", "tiny.toml", "-e", "blob", "-e", "seer", "--snr", "0,5", "-n", "4")


@pytest.fixture
def cli(plugins, tiny, tmp_path, monkeypatch):
    """Run the command line in a folder that holds a small scenario, without drawing figures."""
    drawing = "isacbench.report.html.guarded_pages.draw_run_and_page"
    monkeypatch.setattr(drawing, lambda folder, *_: [folder / "deviation.png"])
    monkeypatch.chdir(tmp_path)

    def call(*args):
        return CliRunner().invoke(app, [str(arg) for arg in args])

    return call


def test_merge_reports_what_it_has_and_says_what_is_missing_if_anything_is(cli):
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


def test_many_gaps_are_counted(cli):
    names = [word for n in range(1, 13) for word in ("-e", f"blob[n={n}]")]
    cli("run", "quick", "-s", "tiny.toml", *names, "--snr", "0", "-n", "2", "--shard", "1/2", "-o", "1")
    lines = cli("merge", "1", "-o", "all").stdout.splitlines()
    assert lines[-12] == "all: 12 of 24 cells"
    assert lines[-1] == "missing: and of 2 more"


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("merge", "gone", "-o", "all"), "gone: not the folder of a run, manifest.json missing"),
        (("rescore", "gone"), "gone: not the folder of a run, manifest.json missing"),
    ],
)
def test_a_folder_that_is_none_ends_in_one_message(cli, tmp_path, args, message):
    result = cli(*args)
    assert result.exit_code == 2
    assert result.stderr.startswith(f"isacbench: {message}")
    assert result.stderr.count("\n") == 1
    assert not (tmp_path / "all").exists()
    assert not (tmp_path / "gone").exists()


def test_rescore_tells_what_changed_and_redraws(cli):
    cli(*RUN, "-o", "out")
    before = pd.read_parquet("out/results.parquet")
    wrong = before.copy()
    wrong.attrs = {}
    wrong.loc[[1, 4], "deviation"] += [0.5, -0.25]
    wrong.to_parquet("out/results.parquet", index=False)
    result = cli("rescore", "out")
    assert result.exit_code == 0, result.output
    assert result.stdout.splitlines()[-2:] == [
        "out: 16 rows scored again, 2 of them differ",
        "deviation: 2 rows, by at most 0.5",
    ]
    pd.testing.assert_frame_equal(pd.read_parquet("out/results.parquet"), before)
    again = cli("rescore", "out")
    assert again.stdout.splitlines()[-1] == "out: 16 rows scored again, 0 of them differ"
