"""Looks at reporting scenes are recorded in a checkout, once each."""

import csv

import pytest

from isacbench.bench.run.looks import record_look
from isacbench.bench.suites.suite import Suite
from isacbench.bench.suites.suite_kinds import load_suite
from isacbench.errors import InputError


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "looks.csv"
    path.write_text("date,suite,first_seed,last_seed,n_scenes,estimators,commit\n")
    return path


def test_a_look_at_reporting_scenes_is_recorded_once(log):
    suite = load_suite("population")
    assert record_look(suite, log) == log
    assert record_look(suite, log) is None
    (row,) = list(csv.DictReader(log.read_text().splitlines()))
    assert (row["suite"], row["n_scenes"]) == ("population", "100")
    assert int(row["last_seed"]) - int(row["first_seed"]) == 99
    assert "music2d" in row["estimators"].split()


def test_developing_and_validating_scenes_and_others_are_no_looks(log):
    scenes = ["town[seed=0:499]", "town[seed=500:999]", "street"]
    suite = Suite(name="mine", scenarios=scenes, estimators=["fft4d"], snr_db=[10], trials=1)
    assert record_look(suite, log) is None
    assert record_look(load_suite("population-quick"), log) is None


def test_without_a_log_nothing_is_recorded(tmp_path):
    assert record_look(load_suite("population"), tmp_path / "none.csv") is None
    assert not list(tmp_path.iterdir())


def test_the_blocks_of_a_population_follow_each_other_and_stay_for_one_use():
    quick = load_suite("population-quick")
    assert quick.in_block(0) is quick
    second = quick.in_block(1)
    assert second.scenarios[0] == "town[seed=532]"
    assert second.scenarios[-1] == "crossing[seed=563,frame=paper,coherent_phase=true]"
    assert len(set(quick.scenarios) & set(second.scenarios)) == 0
    assert quick.in_block(14).scenarios[0] == "town[seed=948]"
    for number in (15, -1):
        with pytest.raises(InputError, match="allowed are blocks whose seeds stay for validating"):
            quick.in_block(number)
    assert load_suite("population").in_block(1).scenarios[0] == "town[seed=1500:1503]"
    with pytest.raises(InputError, match="suite population has no blocks"):
        load_suite("population").model_copy(update={"block_seeds": None}).in_block(1)
