import io
import math
from functools import partial

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.bench.store import csv_table
from isacbench.bench.store.csv_table import write_csv_table

# pandas does not quote a carriage return, and reads what it wrote as two rows.
TEXT = st.text(st.characters(codec="utf-8", exclude_characters="\0\r"), max_size=8)


# Python's own float, for the parser of pandas 2 is off by a last digit here and there.
read = partial(pd.read_csv, converters={"float": lambda text: float(text or "nan")})


def as_pandas_writes(table):
    return read(io.StringIO(table.to_csv(index=False)))


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return tmp_path_factory.mktemp("csv") / "table.csv"


@given(
    st.lists(
        st.tuples(
            TEXT, st.floats(), st.sampled_from([-30.0, 0.0, 1e16, math.nan]), st.integers(-(2**63), 2**63 - 1)
        ),
        min_size=1,
        max_size=20,
    )
)
def test_pandas_reads_back_what_it_would_have_written(path, rows):
    table = pd.DataFrame(rows, columns=["reason, or none", "float", "snr_db", "int"]).astype({"int": "int64"})
    table["hit"] = table["float"] > 0
    write_csv_table(table, path)
    found, expected = read(path), as_pandas_writes(table)
    pd.testing.assert_frame_equal(found, expected, check_exact=True)
    for name in ("float", "snr_db"):
        assert found[name].to_numpy().tobytes() == expected[name].to_numpy().tobytes()


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=50))
def test_floats_come_back_bit_for_bit(path, values):
    table = pd.DataFrame({"value": values})
    write_csv_table(table, path)
    assert read(path)["value"].dtype == np.float64
    found = np.array(path.read_text(encoding="utf-8").splitlines()[1:], dtype=np.float64)
    assert found.tobytes() == table["value"].to_numpy().tobytes()


def test_an_ordinary_table_is_written_byte_for_byte_as_pandas_does(path):
    table = pd.DataFrame(
        {
            "scenario": ["street", "a,b"],
            "params": ['{"n":5}', "{}"],
            "snr_db": [-20.0, 0.5],
            "trial": [0, 1],
            "hit": [True, False],
            "deviation": [math.nan, 11.125],
        }
    )
    write_csv_table(table, path)
    assert path.read_text(encoding="utf-8") == table.to_csv(index=False)


def test_tables_longer_than_one_part_are_whole_and_in_order(path, monkeypatch):
    monkeypatch.setattr(csv_table, "ROWS_AT_ONCE", 3)
    table = pd.DataFrame({"trial": np.arange(10), "score": np.arange(10) / 4, "status": ["ok", ""] * 5})
    write_csv_table(table, path)
    pd.testing.assert_frame_equal(read(path), as_pandas_writes(table), check_exact=True)


@pytest.mark.parametrize("reason", ["a,b", 'a "b"', "a\nb", "a\rb", "a\r\nb", '"', " a "])
def test_text_that_could_be_taken_for_structure_comes_back(path, reason):
    write_csv_table(pd.DataFrame({"reason": [reason, "none"], "trial": [0, 1]}), path)
    assert read(path)["reason"].tolist() == [reason, "none"]


def test_a_table_without_rows_has_its_header(path):
    table = pd.DataFrame({"scenario": pd.Series(dtype="str"), "snr_db": pd.Series(dtype="float64")})
    write_csv_table(table, path)
    assert path.read_text(encoding="utf-8") == "scenario,snr_db\n"


def test_labels_of_rows_do_not_matter(path):
    table = pd.DataFrame({"trial": [1, 2]}, index=[7, 7])
    write_csv_table(table, path)
    assert path.read_text(encoding="utf-8") == "trial\n1\n2\n"
