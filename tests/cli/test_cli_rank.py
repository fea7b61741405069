import json
import re
from functools import partial

import pandas as pd
import pytest


@pytest.fixture
def cli(command_line):
    return partial(command_line, "rank")


@pytest.fixture
def write(scenes_run, written_run):
    """Return a function that writes a made-up run over scenes."""

    def make(**families):
        run = scenes_run(**families)
        return written_run("r", run.rows, run.manifest)

    return make


def test_ranks_wins_and_worst_scenes_are_printed_and_drawn(cli, write, tmp_path):
    write(town=20, crowd=4)
    result = cli("r")
    assert result.exit_code == 0, result.output
    for text in (
        "all scenes: 24 scenes, ranks by ratio",
        "town scenes: 20 scenes, ranks",
        "reference",
        "worst scenes by",
    ):
        assert text in result.stdout
    assert "F-score" in result.stdout
    assert (tmp_path / "r" / "figures" / "ranks-ratio.png").stat().st_size > 10_000


def test_in_a_narrow_terminal_no_number_is_broken_and_long_names_are_numbers(
    cli, scenes_run, written_run, monkeypatch
):
    run = scenes_run(town=8)
    own = run.rows[run.rows["estimator"] == "music2d"]
    params = [json.dumps({"local_dynamic_range_db": 20.0 + n, "pfa": 0.001}) for n in range(6)]
    written_run("r", pd.concat([run.rows, *(own.assign(params=one) for one in params)]), run.manifest)
    monkeypatch.setenv("COLUMNS", "80")
    lines = cli("r").stdout.splitlines()
    assert sum(bool(re.search(r"[+-][.\d]+ to [+-][.\d]+ $", line)) for line in lines) == 8
    wins = "".join(line for line in lines if "(0." in line)
    assert len(re.findall(r"[01]\.\d\d \([01]\.\d\d-[01]\.\d\d\)", wins)) == wins.count("(") == 9 * 8
    assert any(line.startswith(" music2d #7 ") for line in lines)


def test_json_is_all_that_is_printed_and_nothing_is_drawn(cli, write, tmp_path):
    write(town=8)
    result = cli("r", "--json", "--metric", "recall")
    content = json.loads(result.stdout)
    assert (content["metric"], content["better"]) == ("recall", "higher")
    assert len(content["scores"]) == 8 * 3
    assert set(content["scores"][0]) == {"scenario", "estimator", "params", "score"}
    ranked = [row for row in content["ranks"] if not row["is_reference"]]
    assert all(isinstance(row["rank_low"], int) for row in ranked)
    assert [row["rank_low"] for row in content["ranks"] if row["is_reference"]] == [None]
    assert not (tmp_path / "r" / "figures").exists()


def test_of_three_scenes_means_are_printed_as_descriptive_and_nothing_is_drawn(cli, write, tmp_path):
    write(town=3)
    result = cli("r", "--no-html")
    assert result.exit_code == 0, result.output
    assert "descriptive: 3 scenes," in result.stdout
    assert "nothing can be said of unseen ones" in result.stdout
    assert "rank " not in result.stdout.partition("worst scenes")[0]
    assert not (tmp_path / "r" / "figures").exists()
