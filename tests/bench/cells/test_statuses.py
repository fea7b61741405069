from typing import get_args

import pandas as pd

from isacbench.bench.cells.rows import SCORED, CellStatus, failed

FAILURES = ["error", "timeout", "killed", "skipped"]


def test_every_status_but_those_with_a_score_is_a_failure():
    assert set(get_args(CellStatus)) == {*SCORED, *FAILURES}
    records = pd.DataFrame({"status": [*SCORED, *FAILURES]}, index=[7, 3, 5, 2, 9, 1])
    expected = pd.Series([False, False, True, True, True, True], index=records.index)
    pd.testing.assert_series_equal(failed(records), expected, check_names=False)
