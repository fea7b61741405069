import pandas as pd
import pytest

from isacbench.bench.cells.record import COLUMNS, typed
from isacbench.bench.suites.suite_kinds import KINDS
from isacbench.report.run_tables import tables_of, write_run_tables


@pytest.mark.parametrize("kind", KINDS)
def test_a_run_that_was_interrupted_before_its_first_cell_has_no_tables(kind, tmp_path):
    columns = KINDS[kind].columns
    records = typed(pd.DataFrame(columns=[*COLUMNS, *columns]), columns)
    assert tables_of(records, kind) == []
    assert write_run_tables(tmp_path, records, kind) == []
