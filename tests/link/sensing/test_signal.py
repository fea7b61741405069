"""The choices of a link: which are allowed, and which change nothing."""

import itertools

import pytest

from isacbench.errors import InputError
from isacbench.link.sensing.division import Signal


@pytest.mark.parametrize("modulation", ["qpsk", "16qam", "64qam", "256qam"])
def test_only_qpsk_on_the_whole_grid_is_plain_whatever_the_division(modulation):
    for sensing, division in itertools.product(["all", "prs"], ["reciprocal", "matched", "wiener"]):
        signal = Signal(modulation, sensing, division)
        assert signal.has_unit_modulus == (modulation == "qpsk" or sensing == "prs")
        assert signal.is_plain == (modulation == "qpsk" and sensing == "all")


@pytest.mark.parametrize(
    ("name", "value", "meant"),
    [
        ("modulation", "64-qam", "64qam"),
        ("sensing", "pr", "prs"),
        ("division", "wienr", "wiener"),
        ("modulation", "QPSK", "qpsk"),
    ],
)
def test_an_unknown_choice_is_an_error_that_names_the_nearest(name, value, meant):
    with pytest.raises(InputError, match=f"^unknown {name} '{value}': did you mean '{meant}'"):
        Signal(**{name: value})


@pytest.mark.parametrize("name", ["modulation", "sensing", "division"])
def test_a_choice_that_is_no_text_is_an_error_that_names_what_is_allowed(name):
    with pytest.raises(InputError, match=f"^unknown {name} 16: allowed are "):
        Signal(**{name: 16})
