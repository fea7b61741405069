import pytest

from isacbench.bench.compare.comparison import compare_tables
from isacbench.bench.compare.matching import read_run
from isacbench.errors import InputError


def test_a_run_is_read_from_records_and_manifest_alone(made_run, written_run):
    records, manifest = made_run()
    folder = written_run("run", records, manifest)
    run = read_run(folder)
    assert run.label == str(folder)
    assert run.manifest == manifest
    assert set(compare_tables(run, run).curves["verdict"]) == {"same"}


@pytest.mark.parametrize("name", ["results.parquet", "manifest.json"])
def test_a_folder_without_one_of_them_is_refused(made_run, written_run, name):
    folder = written_run("run", *made_run())
    (folder / name).unlink()
    with pytest.raises(InputError, match=f"not the folder of a run, {name} missing"):
        read_run(folder)


@pytest.mark.parametrize(("name", "content"), [("manifest.json", "{"), ("results.parquet", "x")])
def test_a_damaged_run_is_refused(made_run, written_run, name, content):
    folder = written_run("run", *made_run())
    (folder / name).write_text(content)
    with pytest.raises(InputError, match="damaged run"):
        read_run(folder)


@pytest.mark.parametrize("key", ["metric", "environments"])
def test_a_manifest_that_lacks_what_tells_runs_apart_is_refused(made_run, written_run, key):
    records, manifest = made_run()
    del manifest[key]
    with pytest.raises(InputError, match=rf"manifest\.json: {key} missing.*run it again"):
        read_run(written_run("run", records, manifest))


@pytest.mark.parametrize("column", ["environment", "trial"])
def test_records_that_lack_a_column_are_refused(made_run, written_run, column):
    records, manifest = made_run()
    with pytest.raises(InputError, match=rf"results\.parquet: {column} missing"):
        read_run(written_run("run", records.drop(columns=column), manifest))


def test_an_environment_that_the_manifest_does_not_know_is_refused(made_run, written_run):
    records, manifest = made_run()
    records.loc[0, "environment"] = "e9"
    with pytest.raises(InputError, match=r"manifest\.json: e9 missing"):
        read_run(written_run("run", records, manifest))


def test_a_cell_with_two_rows_is_refused(made_run, written_run):
    records, manifest = made_run()
    records.loc[1] = records.loc[0]
    with pytest.raises(InputError, match="1 cells have more than one row"):
        read_run(written_run("run", records, manifest))
