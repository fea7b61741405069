import pandas as pd

from isacbench.bench.statistics import median_times


def rows(**columns):
    return pd.DataFrame({"estimator": "a", "snr_db": 0, "status": "ok", "timing": False, **columns})


def found(records):
    return median_times(records, ["estimator"])["time_estimate_s_median"].to_dict()


def test_the_median_is_that_of_cells_and_not_of_medians_at_each_snr():
    records = rows(snr_db=[0, 0, 0, 10, 10, 10], time_estimate_s=[1.0, 2.0, 9.0, 3.0, 8.0, 9.0])
    assert found(records) == {"a": 5.5}
    assert found(records.assign(snr_db=0)) == {"a": 5.5}


def test_cells_that_failed_have_no_part_in_it_and_what_failed_throughout_has_no_median():
    status = ["ok", "no_detection", "error", "timeout", "error"]
    records = rows(estimator=list("aaaab"), status=status, time_estimate_s=[1.0, 3.0, 50.0, 60.0, 7.0])
    assert found(records) == {"a": 2.0}
    assert found(records[records["estimator"] == "b"]) == {}


def test_where_cells_were_timed_they_count_alone_in_each_group_for_itself():
    records = rows(
        estimator=list("aaab"), timing=[True, True, False, False], time_estimate_s=[1.0, 2.0, 9.0, 4.0]
    )
    assert found(records) == {"a": 1.5, "b": 4.0}
