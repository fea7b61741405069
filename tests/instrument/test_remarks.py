"""Remarks: counted where somebody listens, and nowhere else."""

import pytest

from isacbench.errors import InputError
from isacbench.instrument.remarks import Count, Remarks, remark


def test_remarks_add_up_and_say_nothing_where_there_is_nothing_to_say():
    with Remarks() as remarks:
        remark("unseparated", 0, 5)
        assert remarks.sentences() == []
        remark("unseparated", 2, 5)
    assert remarks.counts == {"unseparated": Count(2, 10)}
    assert remarks.sentences() == [
        "2 of 10 subspaces: signal and noise not separated, no direction taken from them"
    ]


def test_of_two_listeners_the_inner_one_hears_and_outside_nobody_does():
    remark("unseparated", 1, 1)
    with Remarks() as outer:
        with Remarks() as inner:
            remark("unseparated", 1, 1)
        remark("unseparated", 0, 7)
    remark("unseparated", 1, 1)
    assert inner.counts == {"unseparated": Count(1, 1)}
    assert outer.counts == {"unseparated": Count(0, 7)}


def test_an_unknown_remark_is_refused_whether_or_not_somebody_listens():
    with pytest.raises(InputError, match="unseparate"):
        remark("unseparate", 1, 1)
