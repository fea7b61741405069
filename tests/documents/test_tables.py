"""Tables of measured numbers in README and docs against the committed rows."""

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "docs" / "scripts" / "tables.py"


@pytest.fixture(scope="module")
def tables():
    spec = importlib.util.spec_from_file_location("document_tables", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_tables_of_all_pages_are_those_of_the_committed_rows(tables):
    written = []
    for page in tables.PAGES:
        text = (ROOT / page).read_text(encoding="utf-8")
        written += [found[1] for found in tables.MARKED.finditer(text)]
        assert tables.with_tables(text) == text, f"{page}: run python docs/scripts/tables.py"
    assert sorted(written) == sorted(tables.TABLES)
