import math
from functools import partial

import numpy as np
import pandas as pd
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from isacbench.bench.store.run_folder import without_formulas, write_csv_table

# Python's own float, because the parser of pandas 2 can be off by a last digit.
# A text such as 0 stays a text.
read = partial(
    pd.read_csv,
    converters={"float": lambda text: float(text or "nan")},
    dtype={"reason, or none": "str"},
    keep_default_na=False,
)

TEXT = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=8)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return tmp_path_factory.mktemp("csv") / "table.csv"


@example([("0", 0.0, 0, False)])
@given(
    st.lists(
        st.tuples(TEXT, st.floats(), st.integers(-(2**63), 2**63 - 1), st.booleans()), min_size=1, max_size=20
    )
)
def test_a_table_comes_back_bit_for_bit(path, rows):
    columns = ["reason, or none", "float", "int", "hit"]
    table = pd.DataFrame(rows, columns=columns).astype({"int": "int64"})
    write_csv_table(table, path)
    found = read(path)
    pd.testing.assert_frame_equal(found, table, check_exact=True)
    assert np.signbit(found["float"].fillna(0)).equals(np.signbit(table["float"].fillna(0)))


@pytest.mark.parametrize(
    ("table", "text"),
    [
        (
            pd.DataFrame({"deviation": [math.nan, 11.125], "reason": [None, "none"]}),
            '"deviation","reason"\n,\n11.125,"none"\n',
        ),
        (
            pd.DataFrame({"scenario": [], "snr_db": []}).astype({"scenario": "str"}),
            '"scenario","snr_db"\n',
        ),
        (pd.DataFrame({"text": ["=1", "a"]}, index=[7, 7]), '"text"\n"\'=1"\n"a"\n'),
    ],
    ids=["missing values are empty", "no rows", "labels of rows do not matter"],
)
def test_a_table_is_written_as(path, table, text):
    write_csv_table(without_formulas(table), path)
    assert path.read_text(encoding="utf-8") == text
