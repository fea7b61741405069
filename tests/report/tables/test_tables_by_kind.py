import pandas as pd
import pytest

from isacbench.bench.cells.record import COLUMNS, typed
from isacbench.bench.suites.suite_kinds import KINDS
from isacbench.report.tables.tables_by_kind import grids_of


@pytest.mark.parametrize("kind", KINDS)
def test_a_run_that_was_interrupted_before_its_first_cell_has_no_tables(kind, tables_written):
    columns = KINDS[kind].columns
    records = typed(pd.DataFrame(columns=[*COLUMNS, *columns]), columns)
    assert grids_of(records, kind) == []
    assert tables_written(records, kind) == []
