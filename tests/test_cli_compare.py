import json

import pytest
from typer.testing import CliRunner

from isacbench.cli import app


@pytest.fixture
def cli(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return lambda *args: CliRunner().invoke(app, ["compare", *map(str, args)])


@pytest.fixture
def folders(made_run, written_run):
    """Write a run, the same once more, one that is worse, and one of another seed."""
    records, manifest = made_run(trials=12)
    written_run("base", records, manifest)
    written_run("same", records, manifest)
    written_run("other", records, {**manifest, "seed": 7})
    worse = records.copy()
    worse.loc[worse["estimator"] == "music2d", "deviation"] *= 1.2
    written_run("worse", worse, manifest)


def test_without_a_regression_the_exit_code_is_0_and_a_figure_is_drawn(cli, folders, tmp_path):
    result = cli("base", "same")
    assert result.exit_code == 0, result.output
    assert result.stdout.splitlines()[-1] == "no regression: of 2 curves 2 same; of 6 points 6 same"
    assert (tmp_path / "same" / "figures" / "compare-deviation.png").is_file()
    assert result.stderr == ""


def test_a_regression_ends_in_exit_code_4_and_is_tabulated(cli, folders):
    result = cli("base", "worse")
    assert result.exit_code == 4
    assert "street, music2d" in result.stdout
    assert result.stdout.splitlines()[-1].startswith("regression: of 2 curves 1 regression, 1 same")
    assert cli("base", "worse", "--tolerance", "deviation=30%").exit_code == 0
    assert cli("worse", "base").exit_code == 0


def test_what_cannot_be_compared_ends_in_exit_code_5_with_the_reason(cli, folders, tmp_path):
    result = cli("base", "other")
    assert result.exit_code == 5
    assert result.stdout == ""
    assert result.stderr == "isacbench: not comparable: the seed differs: 0 in base, 7 in other\n"
    assert not (tmp_path / "other" / "figures").exists()


def test_json_is_all_that_is_printed_and_draws_only_where_asked(cli, folders, tmp_path):
    result = cli("base", "worse", "--json")
    assert result.exit_code == 4
    content = json.loads(result.stdout)
    assert content["regression"]
    assert {row["verdict"] for row in content["curves"]} == {"same", "regression"}
    assert not (tmp_path / "worse" / "figures").exists()
    cli("base", "worse", "--json", "--plot", "my.png")
    assert (tmp_path / "my.png").is_file()
    refused = cli("base", "other", "--json")
    assert refused.exit_code == 5
    assert json.loads(refused.stdout) == {
        "comparable": False,
        "reasons": ["the seed differs: 0 in base, 7 in other"],
    }


@pytest.mark.parametrize(
    ("args", "fragment"),
    [
        (("base", "nowhere"), "nowhere: not the folder of a run"),
        (("base", "same", "--tolerance", "deviation"), "tolerance 'deviation': allowed is"),
        (("base", "same", "--tolerance", "deviatoin=5%"), "did you mean 'deviation'"),
        (("base", "same", "--tolerance", "n_estimated=5%"), "neither more nor less"),
        (("base", "same", "--alpha", "2"), "alpha = 2.0: allowed is"),
        (("base", "same", "--plot", "my.doc"), "my.doc: a picture takes the extension"),
    ],
)
def test_a_mistake_ends_in_one_line_and_exit_code_2(cli, folders, tmp_path, args, fragment):
    result = cli(*args)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert fragment in result.stderr
    assert result.stderr.count("\n") == 1
    assert not list(tmp_path.rglob("*.png"))
