"""Timed runs from the command line."""

import shutil

import pandas as pd

from isacbench.bench.cells.rows import TIMING_COLUMNS

RUN = ("run", "quick", "-s", "tiny.toml", "-e", "blob", "--snr", "0", "-n", "3")


def test_a_folder_goes_on_timed_is_compared_and_goes_on_without(cli):
    assert cli(*RUN, "-o", "out").exit_code == 0
    timed = cli(*RUN, "--timing", "--repeats", 2, "-o", "out")
    assert timed.exit_code == 0, timed.output
    assert "tiny: median processor time of an estimate and its stages [ms], peak memory [MiB]" in timed.stdout
    assert "out: summary.csv, summary.md, stages.csv, stages.md, " in timed.stdout
    assert pd.read_parquet("out/results.parquet")["timing"].all()

    shutil.copytree("out", "new")
    compared = cli("compare", "out", "new", "--tolerance", "time_estimate_s=1000000%", "--json")
    assert compared.exit_code == 0, compared.output
    assert '"time_estimate_s"' in compared.stdout
    assert "not timed" not in compared.stdout

    assert "stages.md" in cli(*RUN[:-1], 4, "-o", "out").stdout
    records = pd.read_csv("out/results.csv")
    assert (records["timing"] == (records["trial"] < 3)).all()
    assert set(TIMING_COLUMNS) <= set(records)
    assert "stages.md" in cli("report", "out").stdout
    assert "0 of them differ" in cli("rescore", "out").stdout
