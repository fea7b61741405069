"""Running and searching: guarded, in order, the same again, with lines that reproduce what was found."""

import json
import shlex
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from isacbench.checking import stress
from isacbench.checking.stress import (
    BROKEN,
    FAMILIES,
    PROMISES,
    TABLE,
    case_table,
    check_table,
    find_targets,
    run_cases,
    search,
    stress_folder,
    tasks_of,
)
from isacbench.cli import app
from isacbench.errors import InputError
from isacbench.plugins.discovery import PluginFile, isolated_plugins, register_plugin
from isacbench.plugins.registry import detector_names, estimator_names, sees_truth
from tests.conftest import estimator_source

FRAIL = estimator_source(
    "frail",
    """
if self.deed == "die":
    os._exit(5)
if self.deed == "hang":
    time.sleep(60)
if self.deed == "limit" and min(observation.array.shape) < 5:
    raise ValueError("too small")
""",
)

UNTIMED = ["kind", "case", "estimator", "params", "seed", "outcome", "promise", "drift", "bound", "message"]


@pytest.fixture
def frail():
    """Register an estimator that fails in a chosen way."""
    with isolated_plugins():
        register_plugin(PluginFile("frail.py", FRAIL))
        yield


def results_of(specs, cases, **options):
    return list(run_cases(tasks_of(find_targets("estimator", specs), cases, 0), **options))


def test_a_case_that_kills_its_process_or_hangs_has_a_row_and_the_next_goes_on(frail):
    found = results_of(["frail[deed=die]", "frail[deed=hang]", "frail"], ["map[filled=zeros]"], timeout_s=3.0)
    assert [one.status for one in found] == ["killed", "timeout", "ok"]
    assert [one.is_broken for one in found] == [True, True, False]
    assert found[0].worst.message == "the process exited with code 5"


def test_rows_come_in_order_and_are_the_same_again_whatever_the_number_of_processes():
    cases = ["snr[snr_db=0]", "frame"]
    one, two = (case_table(results_of(["oracle", "music2d"], cases, jobs=jobs)) for jobs in (1, 2))
    pd.testing.assert_frame_equal(one[UNTIMED], two[UNTIMED], check_exact=True)
    assert one["estimator"].tolist() == ["oracle"] * 3 + ["music2d"] * 3


def test_another_seed_is_another_noise():
    targets, cases = find_targets("estimator", ["music2d"]), ["single_precision[snr_db=20]"]
    one, other = (check_table(list(run_cases(tasks_of(targets, cases, seed)))) for seed in (0, 1))
    assert (one["seed"].unique().tolist(), other["seed"].unique().tolist()) == ([0], [1])
    assert one["promise"].tolist() == other["promise"].tolist()
    assert one["drift"].tolist() != other["drift"].tolist()


def test_the_search_finds_a_case_that_breaks_and_makes_it_simple(frail):
    targets = find_targets("estimator", ["frail[deed=limit]"])
    (found,) = search(targets, [FAMILIES["array"]], 40, 1, timeout_s=20.0)
    assert found.is_broken
    # Only one of both sizes matters, and two is the smallest there is.
    assert min(found.task.case.values) == 2
    assert "ValueError: too small" in found.worst.message


def test_a_folder_of_something_else_is_left_alone(tmp_path):
    (tmp_path / "manifest.json").write_text("{}", encoding="utf-8")
    with (
        pytest.raises(InputError, match="is not the folder of a stress run"),
        stress_folder(tmp_path, [], 1.0),
    ):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["manifest.json"]


@pytest.fixture
def cli(tmp_path, monkeypatch):
    """Run the command line in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return lambda *args: CliRunner().invoke(app, ["stress", *args])


def test_cases_without_findings_end_with_code_0_and_tables_that_can_be_read(cli):
    result = cli("-e", "oracle", "--case", "frame", "-o", "out")
    assert result.exit_code == 0, result.output
    header, *lines = result.stdout.splitlines()
    assert header.split() == ["case", "estimator", "outcome", "drift", "time"]
    assert lines[0].split()[:3] == ["frame[frame=paper]", "oracle", "ok"]
    assert "2 cases: 2 ok" in result.stdout
    assert {path.name for path in Path("out").glob("[!.]*")} == {PROMISES, TABLE, "stress.json"}
    found = results_of(["oracle"], ["frame"])
    cases = pd.read_csv(f"out/{TABLE}", keep_default_na=False)
    assert cases["case"].tolist() == [one.task.case.spec for one in found]
    assert cases["drift"].astype(float).tolist() == [one.worst.difference for one in found]
    assert len(pd.read_csv(f"out/{PROMISES}")) == sum(len(one.findings) for one in found)
    about = json.loads(Path("out/stress.json").read_text(encoding="utf-8"))
    assert (about["n_cases"], about["n_findings"]) == (2, 0)


def test_references_are_left_out_unless_named(cli, monkeypatch):
    examined = []
    monkeypatch.setattr(stress, "tasks_of", lambda targets, *_: examined.extend(targets) or [])
    assert cli().exit_code == 0
    blind = [name for name in estimator_names() if not sees_truth(name)]
    assert [target.spec for target in examined] == [*blind, *detector_names()]
    examined.clear()
    assert cli("-e", "chance").exit_code == 0
    assert [target.spec for target in examined] == ["chance"]


@pytest.mark.slow
def test_the_whole_table_of_all_estimators_and_detectors_has_no_finding(cli, tmp_path):
    result = cli("-o", "out")
    cases = pd.read_csv(tmp_path / "out" / TABLE, keep_default_na=False)
    broken = cases[cases["outcome"].isin(BROKEN)]
    assert broken[["reproduce", "promise", "message"]].to_numpy().tolist() == []
    assert result.exit_code == 0, result.stderr
    assert set(cases["estimator"]) >= {"nomp4d", "sbl4d", "osca"}


def test_a_finding_ends_with_code_3_and_a_line_that_reproduces_it(cli, tmp_path):
    (tmp_path / "frail.py").write_text(FRAIL, encoding="utf-8")
    with isolated_plugins():
        result = cli("--plugin", "frail.py", "-e", "frail[deed=limit]", "--case", "array[n_u=3,n_w=9]")
    assert result.exit_code == 3
    line = result.stderr.strip().removeprefix("isacbench: 1 finding; the first one: ")
    assert (
        line
        == "isacbench stress --plugin frail.py -e 'frail[deed=limit]' --case 'array[n_u=3,n_w=9]' --seed 0"
    )
    assert line in result.stdout
    with isolated_plugins():
        again = cli(*shlex.split(line)[2:])
    assert again.exit_code == 3


def test_json_is_all_that_is_printed_with_json(cli):
    result = cli("-e", "oracle", "--case", "snr[snr_db=3]", "--json", "-o", "out")
    content = json.loads(result.stdout)
    (case,) = content["cases"]
    assert (case["case"], case["estimator"], case["outcome"]) == ("snr[snr_db=3]", "oracle", "ok")
    assert np.isfinite(case["time_s"])
    assert content["counts"] == {"ok": 1}


def test_a_search_without_findings_says_so(cli):
    result = cli("-e", "oracle", "--case", "frame", "--search", "3", "-o", "out")
    assert result.exit_code == 0, result.output
    assert "searched 3 cases a family for 1 target: no finding" in result.stdout


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["-e", "musik2d"], "unknown estimator 'musik2d'"),
        (["-d", "cfar"], "unknown detector 'cfar'"),
        (["--case", "snt"], "unknown family of cases 'snt'"),
        (["-e", "oracle", "--case", "snr[snr_db=500]"], "allowed are numbers from -80 to 200"),
        (["-d", "ca", "--case", "snr"], "a case for estimators, but only detectors were selected"),
        (["--search", "3", "--case", "snr[snr_db=5]"], "a search draws from families; give snr"),
        (["--search", "3", "-j", "2"], "--jobs 2: --search needs --jobs 1"),
    ],
)
def test_a_mistake_ends_with_code_2_and_one_line(cli, tmp_path, args, message):
    result = cli(*args)
    assert result.exit_code == 2
    assert message in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_a_search_without_hypothesis_names_the_extra_that_brings_it(cli, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "hypothesis", None)
    result = cli("-e", "oracle", "--search", "3")
    assert result.exit_code == 2
    assert result.stderr == "isacbench: --search 3: needs hypothesis: pip install 'isacbench[stress]'\n"
    assert list(tmp_path.iterdir()) == []
