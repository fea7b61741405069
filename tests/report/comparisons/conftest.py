"""Comparisons of made-up runs."""

import copy

import pytest

from isacbench.bench.compare.comparison import compare_tables, parse_tolerance
from isacbench.bench.store.run import Run


@pytest.fixture
def compared(made_run):
    """Return a function that compares a made-up run with a changed one, or its two estimators."""

    def make(change=lambda records: None, tolerances=(), is_between=False, **options):
        records, manifest = made_run(**{"estimators": ("blob", "nomp4d"), **options})
        changed = records.copy()
        change(changed)
        base, new = Run("base", records, manifest), Run("new", changed, copy.deepcopy(manifest))
        if is_between:
            return compare_tables(new, new, partners={("blob", "{}"): ("nomp4d", "{}")}, is_between=True)
        return compare_tables(base, new, map(parse_tolerance, tolerances))

    return make
