"""Folders of runs that somebody else has filled: refused in words, and nothing is written outside of them."""

from __future__ import annotations

import json
import os
import pickle
import shutil
import warnings
import zlib
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from isacbench.bench.cells.record import DRAW_COLUMNS
from isacbench.bench.compare.comparison import compare_tables
from isacbench.bench.compare.matching import NotComparableError, read_run
from isacbench.bench.run.merging import merge
from isacbench.bench.run.rescoring import rescore
from isacbench.bench.run.runner import run_suite
from isacbench.bench.store.run_store import read_results
from isacbench.bench.suites.suite import Suite
from isacbench.errors import InputError
from isacbench.metrics.score import METRIC_VERSION
from isacbench.report.comparisons.comparison_tables import comparison_grids
from isacbench.report.drawing.style import new_figure
from isacbench.report.figures import run_figures
from isacbench.report.figures.run_figures import draw_run
from isacbench.report.tables.run_tables import rich_table
from isacbench.report.tables.tables_by_kind import grids_of, write_run_tables

from .files import ANY, Trap, content, sparse

SCENE = """\
name = "tiny"
[system]
n_subcarriers = 256
n_symbols = 32
[array]
frame = "panel"
tx_shape = [1, 1]
rx_shape = [4, 4]
[base_station]
position_m = [5.0, 40.0, 10.0]
[region]
x_m = [0.0, 10.0]
y_m = [0.0, 10.0]
z_m = [0.0, 5.0]
speed_mps = [-15.0, 15.0]
[[objects]]
kind = "pedestrian"
position_m = [5, 5, 0]
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return a suite and the folder of its run."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "tiny.toml").write_text(SCENE)
    suite = Suite(
        name="test", scenarios=[str(folder / "tiny.toml")], estimators=["oracle"], snr_db=[0, 10], trials=2
    )
    run_suite(suite, out=folder / "run")
    return suite, folder / "run"


@pytest.fixture
def run_folder(made, tmp_path):
    """Return a copy of that folder, beside which something lies that must stay as it is."""
    (tmp_path / "outside").mkdir()
    shutil.copytree(made[1], tmp_path / "inside" / "run")
    return tmp_path / "inside" / "run"


@pytest.fixture
def written_empty(monkeypatch):
    """Leave figures empty, and write all of them."""
    for name in ("draw_deviations", "draw_scores", "draw_clouds"):
        monkeypatch.setattr(run_figures, name, lambda *_: new_figure(1, 1))


def outside(run_folder):
    """What lies outside of the folder, with its contents."""
    return {
        path: path.read_bytes()
        for path in sorted((run_folder.parents[1] / "outside").rglob("*"))
        if path.is_file()
    }


# What stands in the place of a file


def link_out(path):
    """The file itself, moved out of the folder, and a symbolic link to it."""
    target = path.parents[2] / "outside" / path.name
    path.with_name(f"{path.name}.whole").rename(target)
    path.symlink_to(target)


NO_FILES = ["a pipe", "a device", "a folder", "a link to nothing", "a link to itself"]
FILES = ["manifest.json", "results.parquet", "clouds.parquet", "truth.parquet"]
PLACED = {
    **{
        name: ANY[name]
        for name in ("a pipe", "a device", "a folder", "a link to nothing", "a link to itself")
    },
    **{name: ANY[name] for name in ("nothing in it", "pickled", "no text", "a page of zeros")},
    "a terabyte": sparse(2**40),
    "a link out of the folder": link_out,
    "parquet signature": content(b"PAR1" + bytes(100) + b"PAR1"),
    "deep": content(b"[" * 100_000),
    "a list": content(b"[]"),
    "many digits": content(b'{"seed": ' + b"9" * 5000 + b"}"),
}


def place(run_folder, name, write):
    path = run_folder / name
    path.rename(path.with_name(f"{name}.whole"))
    write(path)
    path.with_name(f"{name}.whole").unlink(missing_ok=True)


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("write", PLACED.values(), ids=PLACED)
def test_no_hostile_file_is_a_part_of_a_run(refused, run_folder, name, write):
    place(run_folder, name, write)
    before = outside(run_folder)
    refused(read_results, run_folder)
    refused(rescore, run_folder)
    refused(lambda folder: merge([folder, folder], folder.with_name("merged")), run_folder)
    if name in ("manifest.json", "results.parquet"):
        refused(read_run, run_folder)
    assert outside(run_folder) == before
    assert not list(run_folder.parents[1].rglob("UNPICKLED"))


@pytest.mark.parametrize("name", NO_FILES)
def test_no_hostile_file_is_a_journal(refused, made, run_folder, name):
    ANY[name](run_folder / "journal.jsonl")
    refused(read_results, run_folder)
    refused(read_run, run_folder)
    refused(lambda folder: run_suite(made[0], out=folder), run_folder)


@pytest.mark.parametrize("entry", [[], 1, {"row": 1}, {"columns": 3}, {"row": [], "of": [], "numbers": 0}])
def test_lines_of_a_journal_that_are_whole_but_none_of_ours_are_left_out(run_folder, entry):
    text = json.dumps(entry).encode()
    (run_folder / "journal.jsonl").write_bytes(b"%08x %s\n" % (zlib.crc32(text), text) + b"0" * 10_000)
    with pytest.warns(UserWarning, match="journal.jsonl: damaged"):
        assert len(read_results(run_folder).records) == 4


# Writing


WRITTEN = [
    ".lock",
    "journal.jsonl",
    "manifest.json",
    "results.parquet",
    "results.csv",
    "summary.csv",
    "summary.md",
    "figures",
    ".manifest.json.part",
    ".results.parquet.part",
    ".clouds.parquet.part",
    ".truth.parquet.part",
    ".results.csv.part",
    ".summary.csv.part",
    "figures/deviation.png",
    "figures/.deviation.png.part",
]


LINKED_TO = ["file", "nothing", "pipe"]
LINKS = [
    pytest.param(name, kind, marks=[] if at % 3 == number % 3 else pytest.mark.slow)
    for at, name in enumerate(WRITTEN)
    for number, kind in enumerate(LINKED_TO)
]
"""Every name with one kind of link by default, and with all kinds among the slow tests."""


@pytest.mark.usefixtures("written_empty")
@pytest.mark.parametrize(("name", "kind"), LINKS)
def test_nothing_is_written_through_a_link_out_of_the_folder(made, run_folder, bounded, name, kind):
    target = run_folder.parents[1] / "outside" / "target"
    if name == "figures":
        target.mkdir()
    elif kind == "file":
        target.write_text("precious")
    elif kind == "pipe":
        os.mkfifo(target)
    path = run_folder / name
    path.parent.mkdir(exist_ok=True)
    path.unlink(missing_ok=True)
    path.symlink_to(target)
    before = outside(run_folder)
    told = None
    with bounded(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            results = run_suite(made[0], out=run_folder)
            write_run_tables(run_folder, results.records)
            draw_run(run_folder, with_diagnoses=False)
        except InputError as error:
            told = str(error)
    assert outside(run_folder) == before
    assert (told is not None) == (name in (".lock", "journal.jsonl", "figures"))
    assert told is None or str(path) in told


@pytest.mark.usefixtures("written_empty")
@pytest.mark.parametrize(
    "name", ["summary.csv", "summary.md", "figures", "figures/deviation.png", "results.csv"]
)
def test_what_cannot_be_replaced_is_told(made, run_folder, refused, name):
    path = run_folder / name
    if name == "figures":
        path.write_text("a file")
    else:
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
        path.mkdir(parents=True)
        (path / "inside").touch()

    def work(_path):
        results = run_suite(made[0], out=run_folder)
        write_run_tables(run_folder, results.records)
        draw_run(run_folder, with_diagnoses=False)

    refused(work, path)


# Contents that are read


def resigned(table, path):
    """Write a table without the digest of its content, as a stranger may."""
    table.attrs = {}
    table.to_parquet(path, index=False)


def use(folder, base):
    """Do with a run whatever commands do."""
    results = read_results(folder)
    for grid in grids_of(results.records, results.suite.kind):
        rich_table(grid)
    write_run_tables(folder, results.records, results.suite.kind)
    comparison_grids(compare_tables(base, read_run(folder), [], 0.01))
    rescore(folder)


@pytest.fixture(scope="module")
def base(made):
    """Return the run as comparisons read it."""
    return read_run(made[1])


def use_or_refuse(bounded, folder, base):
    told = str(folder)
    with bounded(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            use(folder, base)
        except NotComparableError:
            pass
        except InputError as error:
            told = str(error)
    assert "MemoryError" not in told


HOSTILE_NAME = '"><script>alert(1)</script>`|$x$\\=\x1b[31m\n../../../etc/passwd'
CHANGES = {
    "no params": ("params", "no JSON"),
    "a list of params": ("params", "[]"),
    "deep params": ("params", "[" * 100_000),
    "params of another kind": ("params", '{"detector": {"name": 1}}'),
    "no status": ("status", "boom"),
    "status missing": ("status", None),
    "infinite SNR": ("snr_db", float("inf")),
    "SNR as text": ("snr_db", "ten"),
    "no SNR": ("snr_db", None),
    "a trial as text": ("trial", "first"),
    "a negative trial": ("trial", -(2**62)),
    "a hostile scenario": ("scenario", HOSTILE_NAME),
    "a hostile estimator": ("estimator", HOSTILE_NAME),
    "a number for an estimator": ("estimator", 7),
    "no estimator": ("estimator", None),
    "a hostile suite": ("suite", HOSTILE_NAME),
    "a hostile reason": ("reason", "=cmd|' /C calc'!A0"),
    "a hostile environment": ("environment", HOSTILE_NAME),
    "infinite deviation": ("deviation", float("inf")),
    "deviation as text": ("deviation", "small"),
    "more points than there are": ("n_estimated", 2**60),
    "time as text": ("time_estimate_s", "soon"),
    "timing as text": ("timing", "yes"),
    "negative time": ("time_estimate_s", -1.0),
    "lists": ("deviation", [1.0]),
}


AMONG_OTHERS = [
    "status missing",
    "infinite SNR",
    "no SNR",
    "a negative trial",
    "no estimator",
    "infinite deviation",
    "more points than there are",
    "negative time",
]
CHANGED = [
    pytest.param(change, rows, id=f"{rows}-{name}", marks=[] if is_default else pytest.mark.slow)
    for name, change in CHANGES.items()
    for rows, is_default in (("one row", name in AMONG_OTHERS), ("all rows", name not in AMONG_OTHERS))
]
"""Every change once by default: numbers and gaps among others, and the rest in rows that agree on it."""


@pytest.mark.parametrize(("change", "rows"), CHANGED)
def test_records_that_nobody_wrote_are_used_or_refused(bounded, base, run_folder, change, rows):
    column, value = change
    table = pd.read_parquet(run_folder / "results.parquet")
    if rows == "all rows":
        table[column] = [value] * len(table)
    else:
        old = table[column].tolist()
        if value is not None and type(value) is not type(old[0]):
            pytest.skip("a column has one type")
        table[column] = [*old[:-1], value]
    resigned(table, run_folder / "results.parquet")
    use_or_refuse(bounded, run_folder, base)


@pytest.mark.parametrize(
    "column", ["params", "status", "snr_db", "trial", "deviation", "environment", "timing"]
)
def test_records_that_lack_a_column_are_used_or_refused(bounded, base, run_folder, column):
    resigned(
        pd.read_parquet(run_folder / "results.parquet").drop(columns=column), run_folder / "results.parquet"
    )
    use_or_refuse(bounded, run_folder, base)


@pytest.mark.parametrize("name", ["results.parquet", "clouds.parquet", "truth.parquet"])
def test_a_table_of_more_rows_than_its_file_can_hold_is_refused(refused, run_folder, name):
    pq.write_table(pa.table({"scenario": pa.nulls(5_000_000)}), run_folder / name)
    assert (run_folder / name).stat().st_size < 10_000
    assert "5000000 rows" in refused(read_results, run_folder)


def test_nothing_in_a_table_is_unpickled(refused, run_folder, tmp_path):
    metadata = {
        b"ARROW:extension:name": b"arrow.py_extension_type",
        b"ARROW:extension:metadata": pickle.dumps(Trap(tmp_path)),
    }
    field = pa.field("scenario", pa.string(), metadata=metadata)
    table = pa.table([pa.array(["tiny"])], schema=pa.schema([field]))
    pq.write_table(table, run_folder / "results.parquet")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        refused(read_results, run_folder)
    assert not (tmp_path / "UNPICKLED").exists()


SHORT_TEXT = st.text(st.characters(), max_size=5)
JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**70), 2**70) | st.floats() | SHORT_TEXT,
    lambda children: st.lists(children, max_size=2) | st.dictionaries(SHORT_TEXT, children, max_size=2),
    max_leaves=4,
)


EXAMPLES = settings.default.max_examples // 6
"""A tenth of a second each; what they found has tests of its own below."""


def places(content, above=()):
    """Paths of everything in a document."""
    items = (
        content.items()
        if isinstance(content, dict)
        else enumerate(content)
        if isinstance(content, list)
        else ()
    )
    for key, value in items:
        yield (*above, key)
        yield from places(value, (*above, key))


def manifest_of(folder):
    return json.loads((folder / "manifest.json").read_text())


@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_manifest_that_nobody_wrote_is_used_or_refused(bounded, made, base, run_folder, data):
    shutil.rmtree(run_folder)
    shutil.copytree(made[1], run_folder)
    manifest = manifest_of(run_folder)
    *above, key = data.draw(st.sampled_from(sorted(places(manifest), key=repr)))
    parent = manifest
    for part in above:
        parent = parent[part]
    if data.draw(st.booleans()):
        parent[key] = data.draw(JSON)
    else:
        del parent[key]
    (run_folder / "manifest.json").write_text(json.dumps(manifest))
    use_or_refuse(bounded, run_folder, base)


def without(*path):
    """Take something out of a manifest."""

    def change(manifest):
        for part in path[:-1]:
            manifest = manifest[part]
        del manifest[path[-1]]

    return change


def another_entry(manifest):
    manifest["scenes"][0]["contestants"] = [7]


def another_scenario(manifest):
    manifest["scenarios"]["elsewhere"] = manifest["scenarios"]["tiny"]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (without("scenarios", "tiny"), "its rows name the scenarios ['tiny'], which its manifest does not"),
        (without("estimators", 0), "contestant 0 of 'tiny'; allowed are indices of the 0 estimators"),
        (another_entry, "contestant 7 of 'tiny'; allowed are indices of the 1 estimators"),
        (without("scenes", 0, "contestants", 0), "scenes[0].contestants = []"),
    ],
)
def test_a_manifest_that_lacks_what_rows_refer_to_is_refused(run_folder, refused, change, told):
    manifest = manifest_of(run_folder)
    change(manifest)
    (run_folder / "manifest.json").write_text(json.dumps(manifest))
    merged = run_folder.with_name("merged")
    for use_of in (read_results, read_run, rescore, lambda folder: merge([folder], merged)):
        assert told in refused(use_of, run_folder)


def test_rows_of_a_scenario_that_the_manifest_lacks_are_refused(run_folder, refused):
    table = pd.read_parquet(run_folder / "results.parquet").assign(scenario="elsewhere")
    resigned(table, run_folder / "results.parquet")
    assert "its rows name the scenarios ['elsewhere']" in refused(read_results, run_folder)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (without("scenarios", "tiny", "content"), "its manifest has no scenarios.tiny.content"),
        (another_scenario, "its manifest describes 2 scenarios, its suite names 1"),
    ],
)
def test_what_parts_cannot_be_merged_without_is_told(run_folder, refused, change, told):
    manifest = manifest_of(run_folder)
    change(manifest)
    (run_folder / "manifest.json").write_text(json.dumps(manifest))
    assert told in refused(lambda folder: merge([folder], folder.with_name("merged")), run_folder)


def test_draws_of_a_scene_that_no_part_has_are_not_merged(run_folder, refused):
    table = pd.DataFrame([["elsewhere", 0, *[0.0] * 6]], columns=DRAW_COLUMNS)
    resigned(table, run_folder / "draws.parquet")
    merged = run_folder.with_name("merged")
    assert "it has draws of 'elsewhere'" in refused(lambda folder: merge([folder], merged), run_folder)


@pytest.mark.parametrize("key", ["sessions", "metric"])
def test_a_manifest_without_sessions_or_metric_is_rescored(run_folder, key):
    manifest = manifest_of(run_folder)
    del manifest[key]
    (run_folder / "manifest.json").write_text(json.dumps(manifest))
    assert rescore(run_folder).n_changed == 0
    assert manifest_of(run_folder)["metric"] == {"name": "paper", "version": METRIC_VERSION}


@pytest.mark.parametrize("value", [False, 3, [], {"a": {"b": 1}}])
def test_a_version_that_is_no_text_is_refused(made, run_folder, value):
    manifest = manifest_of(run_folder)
    (environment,) = manifest["environments"].values()
    environment["versions"]["isacbench"]["digest"] = value
    (run_folder / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(InputError, match=r"manifest.json: .*versions"):
        read_results(run_folder)


def test_a_path_that_is_no_text_is_kept(made, run_folder):
    """Names of files are bytes; the manifest holds them as JSON can."""
    folder = Path(os.fsdecode(os.fsencode(run_folder.parent) + b"/\xff"))
    folder.mkdir()
    shutil.copy(made[1].parent / "tiny.toml", folder)
    suite = made[0].replace(scenarios=[str(folder / "tiny.toml")])
    run_suite(suite, out=run_folder.with_name("other"))
    assert read_results(run_folder.with_name("other")).suite.scenarios == suite.scenarios
