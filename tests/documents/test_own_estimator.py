"""The estimator of docs/own-estimator.md keeps the contract, and images a street."""

import pytest

import isacbench
from tests.documents.sources import python_blocks


@pytest.fixture(scope="module")
def plugin_file(tmp_path_factory):
    """File with the code of the page."""
    (code,) = python_blocks("docs/own-estimator.md")
    path = tmp_path_factory.mktemp("own") / "tapered2d.py"
    path.write_text(code, encoding="utf-8")
    return path


def test_the_estimator_of_the_page_keeps_the_contract(plugin_file):
    assert isacbench.check(plugin_file).ok


def test_its_beam_is_wider_and_it_is_named_in_runs(plugin_file, tmp_path):
    rows = isacbench.run(
        "quick",
        estimators=["tapered2d", "bartlett2d"],
        plugins=[plugin_file],
        snr_db=[10],
        trials=1,
        out=tmp_path / "run",
    )
    points = rows.set_index("estimator")["n_estimated"]
    assert 20 < points["tapered2d"] < points["bartlett2d"]
