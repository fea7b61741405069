from typing import get_args

import pandas as pd

from isacbench.bench.cells.record import SCORED, CellStatus, failed

FAILURES = ["error", "timeout", "killed", "skipped"]


def test_every_status_but_those_with_a_score_is_a_failure():
    assert set(get_args(CellStatus)) == {*SCORED, *FAILURES}
    records = pd.DataFrame({"status": [*SCORED, *FAILURES]})
    assert failed(records).tolist() == [False, False, True, True, True, True]


def test_the_answer_has_the_index_of_the_rows():
    records = pd.DataFrame({"status": ["timeout", "ok"]}, index=[7, 3])
    pd.testing.assert_series_equal(failed(records), pd.Series({7: True, 3: False}), check_names=False)
