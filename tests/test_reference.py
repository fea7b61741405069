"""A fresh run is held against the committed curves."""

from pathlib import Path

import pytest

from isacbench import run
from isacbench.bench.compare.comparison import compare_tables
from isacbench.bench.store.run import Run

REFERENCES = Path(__file__).parent.parent / "results" / "reference"


@pytest.mark.parametrize("suite", ["quick", pytest.param("paper", marks=pytest.mark.slow)])
def test_a_fresh_run_is_no_worse_than_the_committed_curves(suite, tmp_path):
    records = run(suite, out=tmp_path / suite, jobs=2)
    base = Run.open(REFERENCES / suite).require_finished()
    assert len(records) == len(base.rows)
    comparison = compare_tables(base, Run.open(tmp_path / suite).require_finished())
    assert not comparison.is_regression, comparison
