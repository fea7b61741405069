import pandas as pd
import pytest
from isacbench.report.tables.tables_by_kind import grids_of, write_run_tables

from isacbench.bench.cells.record import COLUMNS, typed
from isacbench.bench.suites.suite_kinds import KINDS


@pytest.mark.parametrize("kind", KINDS)
def test_a_run_that_was_interrupted_before_its_first_cell_has_no_tables(kind, tmp_path):
    columns = KINDS[kind].columns
    records = typed(pd.DataFrame(columns=[*COLUMNS, *columns]), columns)
    assert grids_of(records, kind) == []
    assert write_run_tables(tmp_path, records, kind) == []
