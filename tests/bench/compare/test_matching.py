import pytest

from isacbench.bench.compare.comparison import compare_tables
from isacbench.bench.store.run import Run
from isacbench.errors import InputError


def test_a_run_is_read_from_records_and_manifest_alone(made_run, written_run):
    records, manifest = made_run()
    folder = written_run("run", records, manifest)
    run = Run.open(folder).require_finished()
    assert run.label == str(folder)
    assert run.manifest == manifest
    assert set(compare_tables(run, run).curves["verdict"]) == {"same"}


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda folder: (folder / "results.parquet").unlink(), r"has no rows, results\.parquet is missing"),
        (lambda folder: (folder / "manifest.json").unlink(), r"of a run, manifest\.json missing"),
        (lambda folder: (folder / "results.parquet").write_text("x"), "damaged run"),
        (lambda folder: (folder / "manifest.json").write_text("{"), "damaged run"),
        (lambda folder: (folder / "journal.jsonl").write_text(""), "the run is not finished; resume it"),
    ],
)
def test_a_folder_that_holds_no_finished_run_is_refused(made_run, written_run, spoil, message):
    folder = written_run("run", *made_run())
    spoil(folder)
    with pytest.raises(InputError, match=message):
        Run.open(folder).require_finished()


@pytest.mark.parametrize(
    ("lose", "message"),
    [
        (lambda _, manifest: manifest.pop("seed"), r"manifest\.json: seed missing.*run it again"),
        (lambda _, manifest: manifest["environments"].pop("e1"), r"manifest\.json: e1 missing"),
        (lambda records, _: records.pop("environment"), r"results\.parquet has no column environment"),
        (lambda records, _: records.pop("trial"), r"results\.parquet has no column trial"),
    ],
)
def test_what_a_comparison_needs_and_is_not_there_is_named(made_run, written_run, lose, message):
    records, manifest = made_run()
    lose(records, manifest)
    with pytest.raises(InputError, match=message):
        Run.open(written_run("run", records, manifest)).require_finished()


def test_a_cell_with_two_rows_is_refused(made_run, written_run):
    records, manifest = made_run()
    records.loc[1] = records.loc[0]
    with pytest.raises(InputError, match=r"results\.parquet has several rows of a cell"):
        Run.open(written_run("run", records, manifest)).require_finished()
