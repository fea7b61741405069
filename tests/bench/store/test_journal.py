"""The journal: what is written comes back bit for bit, what is damaged is noticed."""

import math
import struct
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.bench.cells.rows import COLUMNS, Row
from isacbench.bench.store.run_folder import Journal, read_journal
from isacbench.errors import InputError
from isacbench.model.cloud import PointCloud

COLUMNS_OF_STUDY = {"hits": 0, "rate": math.nan, "resolved": False, "label": ""}

# Half characters are made visible before they become part of a row: no table would take them.
texts = st.text(st.characters(codec="utf-8"), max_size=20)
any_float = st.floats(allow_nan=True, allow_infinity=True, allow_subnormal=True)
finite = st.floats(allow_nan=False, allow_infinity=False, allow_subnormal=True)
points = st.lists(st.tuples(finite, finite, finite, finite, finite), max_size=4)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("journals")


def made(cloud=(), extras=None, environment=None, **changes):
    values = {
        "suite": "suite",
        "scenario": "tiny",
        "estimator": "good",
        "params": "{}",
        "snr_db": 0.0,
        "trial": 0,
        "seed": 0,
        "scenario_content": "content",
        "status": "ok",
        "reason": "",
        "n_true": 3,
        "n_estimated": 0,
        "timing": False,
        "environment": "here",
    }
    cloud = PointCloud.from_array(np.reshape(np.array(cloud, dtype=np.float64), (-1, 5)))
    return Row({**values, **changes}, environment or {"versions": {}}, extras or {}, cloud)


def written(path, *rows, columns=COLUMNS_OF_STUDY):
    path.unlink(missing_ok=True)
    with closing(Journal(path, columns)) as journal:
        for row in rows:
            journal.append(row)
    return path


def bits(value):
    """What tells -0 from 0 and one NaN as another."""
    return "NaN" if math.isnan(value) else struct.pack("<d", value)


@given(
    values=st.fixed_dictionaries({"snr_db": any_float, "deviation": any_float, "rate": any_float}),
    whole=st.fixed_dictionaries({"trial": st.integers(0, 2**62), "hits": st.integers(-(2**62), 2**62)}),
    words=st.fixed_dictionaries({"reason": texts, "scenario": texts, "label": texts}),
    resolved=st.booleans(),
    cloud=points,
)
def test_a_row_comes_back_bit_for_bit_also_from_numpy(folder, values, whole, words, resolved, cloud):
    entries = {**values, **whole, **words}
    extras = {name: entries.pop(name) for name in ("rate", "hits", "label")}
    extras |= {"hits": np.int64(extras["hits"]), "resolved": np.bool_(resolved)}
    rows, clouds, _, n_torn = read_journal(written(folder / "row", made(cloud, extras, **entries)))
    assert n_torn == 0
    row = rows.iloc[0]
    assert row[[*whole, *words]].to_dict() == {**whole, **words}
    assert row["resolved"] == resolved
    assert [bits(row[name]) for name in values] == [bits(value) for value in values.values()]
    (found,) = clouds
    assert found.tobytes() == np.array(cloud, dtype="<f8").tobytes()
    assert len(found) == len(cloud)


def test_a_row_without_values_of_the_study_gets_its_own(folder):
    rows = read_journal(written(folder / "defaults", made())).rows
    assert sorted(rows.columns) == sorted([*COLUMNS, *COLUMNS_OF_STUDY])
    assert rows.loc[0, ["hits", "resolved", "label"]].tolist() == [0, False, ""]


def test_environments_are_kept_once_by_name(folder):
    here, there = {"versions": {"numpy": "1"}}, {"versions": {"numpy": "2"}}
    path = written(
        folder / "environments",
        *(made(environment=here, trial=n) for n in range(3)),
        replace(made(environment=there, trial=3), result={"environment": "there"}),
    )
    assert path.read_bytes().count(b'"environment":"here","is"') == 1
    assert read_journal(path).environments == {"here": here, "there": there}


def test_an_empty_journal_has_no_rows(folder):
    rows, clouds, _, n_torn = read_journal(written(folder / "empty"))
    assert len(rows) == len(clouds) == n_torn == 0


TRIALS = 3


@pytest.fixture(scope="module")
def content(folder):
    rows = [made([[n, 0, 0, 0, 1]] * n, trial=n, reason=f"reason {n}") for n in range(TRIALS)]
    return written(folder / "content", *rows).read_bytes()


@pytest.fixture(scope="module")
def whole(folder, content):
    return read_bytes(folder, content)


def read_bytes(folder, content):
    path = folder / "changed"
    path.write_bytes(content)
    return read_journal(path)


@given(data=st.data())
def test_a_cut_keeps_every_row_before_it(folder, content, data):
    place = data.draw(st.integers(0, len(content)))
    rows, clouds, _, n_torn = read_bytes(folder, content[:place])
    ends = [n for n, byte in enumerate(content) if byte == 10]  # without its newline, a line is whole
    n_rows = sum(end <= place for end in ends[2:])  # behind columns and environment
    assert rows.get("trial", np.empty(0)).tolist() == list(range(n_rows))
    assert n_torn == (place > 0 and content[place - 1] != 10 and place not in ends)
    assert [len(cloud) for cloud in clouds] == list(range(n_rows))


@given(data=st.data())
def test_a_bit_that_flips_never_yields_a_row_that_was_not_written(folder, content, whole, data):
    place, bit = data.draw(st.integers(0, len(content) - 1)), data.draw(st.integers(0, 7))
    flipped = bytearray(content)
    flipped[place] ^= 1 << bit
    rows, clouds, _, n_torn = read_bytes(folder, bytes(flipped))
    kept = rows.get("trial", np.empty(0)).tolist()
    assert set(kept) <= set(range(TRIALS))
    assert len(kept) == len(set(kept))
    if kept:
        assert rows.to_csv() == whole.rows.iloc[kept].reset_index(drop=True).to_csv()
        expected = [whole.clouds[place] for place in kept]
        assert [cloud.tobytes() for cloud in clouds] == [cloud.tobytes() for cloud in expected]
    assert n_torn or kept == list(range(TRIALS))


@pytest.mark.parametrize("name", ["exists", "missing/journal.jsonl"])
def test_a_journal_that_exists_or_cannot_be_written_is_told(folder, name):
    path = written(folder / "exists", made())
    with pytest.raises(InputError, match=r"exists: cannot be written: File exists|jsonl: cannot be written"):
        Journal(folder / name, {})
    assert len(read_journal(path).rows) == 1
