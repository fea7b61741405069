"""Folders of runs that somebody else has filled: refused in words, and nothing is written outside of them."""

from __future__ import annotations

import json
import pickle
import shutil
import warnings

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from isacbench.bench.compare.comparison import compare
from isacbench.bench.compare.pairs import NotComparableError
from isacbench.bench.run.merging import merge
from isacbench.bench.run.rescoring import rescore
from isacbench.bench.run.runner import run_suite
from isacbench.bench.store.run import Run
from isacbench.errors import InputError
from isacbench.metrics.paper import Paper
from isacbench.report.comparison import ComparisonReport
from isacbench.report.run_report import draw_run, write_run_tables
from isacbench.report.tables import terminal_tables

from .files import ANY, Trap, content


@pytest.fixture
def run_folder(made, tmp_path):
    """Return a copy of that folder."""
    return shutil.copytree(made[1], tmp_path / "run")


# What stands in the place of a file


FILES = ["manifest.json", "results.parquet", "clouds.parquet", "truth.parquet"]
PLACED = {
    **{name: ANY[name] for name in ("a folder", "nothing in it", "pickled", "a page of zeros")},
    "parquet signature": content(b"PAR1" + bytes(100) + b"PAR1"),
    "a list": content(b"[]"),
}


def read_all(folder):
    """Read a run with what is otherwise read at first use."""
    run = Run.open(folder)
    return run, run.points, run.scenarios


@pytest.mark.parametrize("name", FILES)
def test_no_hostile_file_is_a_part_of_a_run(refused, made, tmp_path, name):
    whole = (made[1] / name).read_bytes()
    for kind, write in {**PLACED, "half of it": content(whole[: len(whole) // 2])}.items():
        run_folder = shutil.copytree(made[1], tmp_path / kind / "run")
        (run_folder / name).unlink()
        write(run_folder / name)
        refused(read_all, run_folder)
        refused(rescore, run_folder)
        refused(lambda folder: merge([folder, folder], folder.with_name("merged")), run_folder)
    assert not list(tmp_path.rglob("UNPICKLED"))


# Writing


def run_and_report(suite, run_folder):
    results = run_suite(suite, out=run_folder)
    write_run_tables(results)
    draw_run(results)


WRITTEN = ["summary.csv", "summary.md", "figures", "figures/deviation.png", "results.csv"]


@pytest.mark.usefixtures("written_empty")
@pytest.mark.parametrize("name", WRITTEN)
def test_what_cannot_be_replaced_is_told(made, run_folder, refused, name):
    path = run_folder / name
    if name == "figures":
        path.write_text("a file")
    else:
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
        path.mkdir(parents=True)
        (path / "inside").touch()

    refused(lambda _path: run_and_report(made[0], run_folder), path)


# Contents that are read


def change_records(folder, without=(), **columns):
    """Change rows of a run and leave the digest of their content out, as a stranger may."""
    table = pd.read_parquet(folder / "results.parquet").assign(**columns).drop(columns=[*without])
    table.attrs = {}
    table.to_parquet(folder / "results.parquet", index=False)


def change_manifest(folder, without):
    manifest = json.loads((folder / "manifest.json").read_text())
    del manifest[without]
    (folder / "manifest.json").write_text(json.dumps(manifest))


HOSTILE_NAME = '"><script>alert(1)</script>`|$x$\\=\x1b[31m\n../../../etc/passwd'
CHANGES = {
    "an unknown status": {"status": "boom"},
    "no SNR": {"snr_db": None},
    "a trial as text": {"trial": "first"},
    "a hostile scenario": {"scenario": HOSTILE_NAME},
    "a hostile estimator": {"estimator": HOSTILE_NAME},
    "a hostile reason, more points than there are": {"reason": "=cmd|' /C calc'!A0", "n_estimated": 2**60},
    "deviation as text": {"deviation": "small"},
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_records_that_isacbench_did_not_write_are_used_or_refused(bounded, made, run_folder, change):
    change_records(run_folder, **change)
    told = ""
    with bounded(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            results = Run.open(run_folder)
            for table in write_run_tables(results)[1]:
                terminal_tables(table, 100)
            ComparisonReport(compare(made[1], run_folder)).tables()
            rescore(run_folder)
        except NotComparableError:
            pass
        except InputError as error:
            told = str(error)
    assert "MemoryError" not in told


@pytest.mark.parametrize("column", ["params", "deviation"])
def test_records_that_lack_a_column_are_refused(refused, run_folder, column):
    change_records(run_folder, without=[column])
    assert f"no column {column}" in refused(Run.open, run_folder)


def test_nothing_in_a_table_is_unpickled(refused, run_folder, tmp_path):
    metadata = {"name": b"arrow.py_extension_type", "metadata": pickle.dumps(Trap(tmp_path))}
    metadata = {f"ARROW:extension:{key}": value for key, value in metadata.items()}
    field = pa.field("scenario", pa.string(), metadata=metadata)
    pq.write_table(pa.table({"scenario": ["tiny"]}, pa.schema([field])), run_folder / "results.parquet")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        refused(Run.open, run_folder)
    assert not (tmp_path / "UNPICKLED").exists()


@pytest.mark.parametrize("key", ["suite", "scores", "scenarios"])
def test_a_manifest_that_lacks_a_part_is_refused(refused, run_folder, key):
    change_manifest(run_folder, key)
    assert key in refused(Run.open, run_folder)


def test_rows_of_a_scenario_that_the_manifest_lacks_are_refused(run_folder, refused):
    change_records(run_folder, scenario="elsewhere")
    assert "its rows name the scenarios ['elsewhere']" in refused(Run.open, run_folder)


def test_a_manifest_without_sessions_is_rescored(run_folder):
    change_manifest(run_folder, "sessions")
    assert not [change for change in rescore(run_folder).changes if change.n_rows]
    manifest = json.loads((run_folder / "manifest.json").read_text())
    assert manifest["scores"]["metrics"]["paper"]["version"] == Paper.version
