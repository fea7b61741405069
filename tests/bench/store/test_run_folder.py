"""The folder of a run: one run writes into it at a time, and its files are whole."""

import math
import os
from functools import partial

import numpy as np
import pandas as pd
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from isacbench.bench.store.run_folder import (
    atomic_write,
    default_folder,
    open_folder,
    without_formulas,
    write_csv_table,
)
from isacbench.errors import InputError


@pytest.mark.parametrize(
    ("name", "message"),
    [("thesis", "is not the folder of a run"), (".lock", "cannot be locked: Is a directory; use a folder")],
)
def test_a_folder_of_something_else_is_refused_and_left_alone(tmp_path, name, message):
    (tmp_path / name).mkdir()
    with pytest.raises(InputError, match=message), open_folder(tmp_path):
        pass
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_an_empty_existing_folder_is_taken_and_stays(tmp_path):
    with open_folder(tmp_path) as folder:
        assert folder == tmp_path
    assert tmp_path.is_dir()


def test_a_file_in_place_of_the_folder_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be created or read"), open_folder(tmp_path / "file"):
        pass


def test_a_new_folder_that_stays_empty_goes_away(tmp_path):
    with pytest.raises(RuntimeError), open_folder(tmp_path / "run"):
        raise RuntimeError
    assert not (tmp_path / "run").exists()


def test_a_folder_that_is_written_into_is_refused_with_who_does(tmp_path):
    with (
        open_folder(tmp_path / "run"),
        pytest.raises(InputError, match=rf"another run is writing into it \(process {os.getpid()} on "),
        open_folder(tmp_path / "run"),
    ):
        pass


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("old")
    with pytest.raises(UnicodeEncodeError), atomic_write(path) as temporary:
        temporary.write_text("half \ud800", encoding="utf-8")
    assert path.read_text() == "old"
    assert [file.name for file in tmp_path.iterdir()] == ["table.csv"]
    with atomic_write(path) as temporary:
        temporary.write_text("new")
    assert path.read_text() == "new"


def test_the_default_folder_is_named_after_suite_and_time():
    assert default_folder("quick").match("results/quick-20??????-??????")


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
