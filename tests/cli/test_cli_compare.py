import errno
import json
from functools import partial
from pathlib import Path
from xml.etree import ElementTree

import pytest

from isacbench.bench.store.run_folder import open_folder
from isacbench.report import comparison
from isacbench.report.figures import new_figure

DRAW_CHARTS = comparison.draw_charts


@pytest.fixture
def cli(command_line, monkeypatch):
    """Run the command in a folder of its own; figures are left empty."""
    monkeypatch.setattr(comparison, "draw_charts", lambda *_: new_figure(1, 1))
    return partial(command_line, "compare")


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


def everything(folder):
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*")}


def test_without_a_regression_the_exit_code_is_0_and_nothing_but_a_figure_and_the_page_is_made(
    cli, folders, tmp_path, monkeypatch
):
    monkeypatch.setattr(comparison, "draw_charts", DRAW_CHARTS)
    before = everything(tmp_path)
    result = cli("base", "same")
    assert result.exit_code == 0, result.output
    assert result.stdout.splitlines()[-1] == "no regression: of 2 curves 2 same; of 6 points 6 same"
    assert result.stderr == ""
    after = everything(tmp_path)
    new = {path.relative_to(tmp_path).as_posix() for path in after.keys() - before.keys()}
    assert new == {"same/figures", "same/figures/compare-deviation.png", "same/compare.html"}
    assert {path: after[path] for path in before if path.is_file()} == {
        path: time for path, time in before.items() if path.is_file()
    }


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


@pytest.fixture
def retuned(made_run, written_run):
    """Write two runs whose nomp4d has other parameters, and is worse in the second one."""
    records, manifest = made_run(estimators=("chance", "nomp4d"), trials=12)
    chosen = records["estimator"] == "nomp4d"
    for name, pfa, factor in (("old", 0.001, 1.0), ("new", 0.0001, 1.2)):
        params = records["params"].where(~chosen, f'{{"pfa":{pfa}}}')
        deviation = records["deviation"].where(~chosen, factor * records["deviation"])
        written_run(name, records.assign(params=params, deviation=deviation), manifest)


def test_a_pair_that_is_mapped_is_shown_under_both_names(cli, retuned, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    result = cli("old", "new", "--map", "nomp4d[pfa=1e-3]=nomp4d[pfa=1e-4]")
    assert result.exit_code == 4, result.output
    lines = result.stdout.splitlines()
    place = next(number for number, line in enumerate(lines) if line.startswith(" street, nomp4d[pfa=0.001]"))
    assert lines[place].endswith("regression ")
    assert lines[place + 1].startswith("   → nomp4d[pfa=0.0001] ")
    assert max(len(line) for line in lines[place - 4 : place + 2]) <= 100
    assert "missing" not in result.stdout
    content = json.loads(cli("old", "new", "--map", "nomp4d=nomp4d", "--json").stdout)
    (row,) = [row for row in content["curves"] if row["estimator"] == "nomp4d"]
    assert (row["params"], row["new_params"]) == ('{"pfa":0.001}', '{"pfa":0.0001}')


def test_two_estimators_of_one_run_are_worse_or_better_and_drawn_beside_it(cli, retuned, tmp_path):
    result = cli("old", "--between", "chance", "--and", "nomp4d[pfa=1e-3]")
    assert result.exit_code == 4
    lines = result.stdout.splitlines()
    assert lines[:3] == ["A chance", "B nomp4d[pfa=0.001]", "in old: isacbench 0.1.0 (0123456789)"]
    assert lines[-1] == "nomp4d[pfa=0.001] is worse than chance: of 1 curve 1 worse; of 3 points 3 worse"
    assert (tmp_path / "old" / "figures" / "between-deviation.png").is_file()
    back = cli("old", "--between", "nomp4d", "--and", "chance", "--json")
    assert back.exit_code == 0
    assert json.loads(back.stdout)["between"] == ["nomp4d[pfa=0.001]", "chance"]


def test_files_for_continuous_integration_are_written_whatever_the_exit_code(cli, folders, tmp_path):
    (tmp_path / "ci.md").write_text("of an earlier run")
    for words, code, verdict in (
        ("base same", 0, "no regression"),
        ("base worse --json", 4, "regression"),
        ("base other", 5, "not comparable"),
    ):
        result = cli(*words.split(), "--markdown", "ci.md", "--junit", "ci.xml")
        assert result.exit_code == code
        assert (tmp_path / "ci.md").read_text().startswith(f"### isacbench compare: {verdict}\n")
        suites = ElementTree.parse(tmp_path / "ci.xml").getroot()
        assert (suites.attrib["failures"] > "0", suites.attrib["errors"] > "0") == (code == 4, code == 5)
        files = {path.name for path in tmp_path.iterdir()}
        assert files == {"base", "same", "worse", "other", "ci.md", "ci.xml"}


def test_a_run_that_is_being_written_is_compared_and_not_drawn_into(cli, folders, tmp_path):
    (tmp_path / "same" / ".lock").touch()
    before = everything(tmp_path)
    with open_folder(tmp_path / "same"):
        result = cli("base", "same")
    assert result.exit_code == 0, result.output
    assert "no figures: same: a run writes into it" in result.stdout.splitlines()
    assert everything(tmp_path).keys() == before.keys()


def test_a_folder_that_cannot_be_written_is_compared_and_not_drawn_into(cli, folders, tmp_path, monkeypatch):
    def refuse(path, *_args, **_options):
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    (tmp_path / "plain").touch()
    refused = cli("base", "worse", "--plot", "plain/x.png")
    assert (refused.exit_code, refused.stderr.count("\n")) == (2, 1)
    assert "plain/x.png: cannot be written" in refused.stderr
    before = everything(tmp_path)
    monkeypatch.setattr(Path, "mkdir", refuse)
    result = cli("base", "worse", "--no-html")
    assert result.exit_code == 4
    assert "no figures: worse/figures: cannot be written: Permission denied" in result.stdout.splitlines()
    assert everything(tmp_path) == before
