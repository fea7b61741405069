"""Stages of an estimate: each second belongs to one of them, and nothing else changes."""

from contextlib import nullcontext
from threading import Thread

import pytest

from isacbench.errors import InputError
from isacbench.instrument.stages import STAGES, StageClock, stage
from isacbench.model.echo import observe_echo
from isacbench.model.scenes.scenario import load_scenario
from isacbench.plugins.registry import get_estimator


class Hand:
    """A clock whose time passes when a test says so."""

    def __init__(self):
        self.time_s = 100.0

    def __call__(self):
        return self.time_s

    def spend(self, time_s):
        self.time_s += time_s


@pytest.fixture
def hand():
    return Hand()


def test_a_stage_has_the_time_that_passes_in_it_but_not_that_of_an_inner_one(hand):
    with StageClock(hand) as clock:
        hand.spend(32)
        with stage("peaks"):
            hand.spend(1)
            with stage("spectrum"):
                hand.spend(2)
                with stage("rdm"):
                    hand.spend(4)
                hand.spend(8)
            hand.spend(16)
        hand.spend(64)
    assert clock.seconds == {"peaks": 17, "spectrum": 10, "rdm": 4}
    assert clock.total_s == 127


def test_a_stage_adds_up_over_its_occurrences_and_within_itself(hand):
    with StageClock(hand) as clock:
        for _ in range(3):
            with stage("peaks"):
                hand.spend(1)
                with stage("peaks"):
                    hand.spend(2)
    assert clock.seconds == {"peaks": 9}


def test_a_stage_without_time_has_occurred(hand):
    with StageClock(hand) as clock, stage("subspace"):
        pass
    assert clock.seconds == {"subspace": 0}


def test_an_exception_passes_and_ends_the_stages_that_it_leaves(hand):
    def fail():
        with stage("refinement"), stage("subspace"):
            hand.spend(2)
            raise ZeroDivisionError

    with StageClock(hand) as clock, stage("peaks"):
        hand.spend(1)
        with pytest.raises(ZeroDivisionError):
            fail()
        hand.spend(4)
    assert clock.seconds == {"peaks": 5, "refinement": 0, "subspace": 2}


def test_a_clock_that_an_exception_leaves_measures_no_more(hand):
    clock = StageClock(hand)

    def fail():
        with clock:
            hand.spend(1)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    with stage("rdm"):
        hand.spend(1)
    assert (clock.seconds, clock.total_s) == ({}, 1)


def test_the_inner_of_two_clocks_alone_sees_the_stages_within(hand):
    with StageClock(hand) as outer, stage("detection"):
        hand.spend(1)
        with StageClock(hand) as inner, stage("rdm"):
            hand.spend(2)
    assert inner.seconds == {"rdm": 2}
    assert outer.seconds == {"detection": 3}


def test_the_stage_that_waits_for_a_thread_has_its_time(hand):
    def work():
        with stage("subspace"):
            hand.spend(2)

    with StageClock(hand) as clock, stage("spectrum"):
        thread = Thread(target=work)
        thread.start()
        thread.join()
    assert clock.seconds == {"spectrum": 2}


@pytest.mark.parametrize("measuring", [nullcontext, StageClock])
def test_an_unknown_stage_is_refused_whether_anybody_measures_or_not(measuring):
    with measuring(), pytest.raises(InputError, match="unknown stage 'peak': did you mean 'peaks'"):
        stage("peak")


CELLWISE = {"rdm", "detection", "spectrum", "peaks"}
FITTED = {*CELLWISE, "refinement"}

MARKED = {
    **dict.fromkeys(["fft4d", "bartlett2d", "capon2d"], CELLWISE),
    **dict.fromkeys(["iaa2d", "nomp4d", "omp4d", "sbl4d"], FITTED),
    "music2d": {*STAGES} - {"refinement"},
    "music2d_joint": {*STAGES},
    "esprit2d": {*STAGES} - {"spectrum"},
}


def test_every_estimator_marks_the_stages_that_it_has(tiny):
    observation = observe_echo(load_scenario(tiny), snr_db=10)
    for name, stages in MARKED.items():
        estimator = get_estimator(name)
        with StageClock() as clock:
            cloud = estimator.estimate(observation)
        assert {*clock.seconds} == stages, name
        assert (cloud.to_array() == estimator.estimate(observation).to_array()).all(), name
