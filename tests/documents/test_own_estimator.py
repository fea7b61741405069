"""The estimator of docs/own-estimator.md keeps the contract, and images a street."""

import re
from pathlib import Path

import pytest

import isacbench

DOCUMENT = Path(__file__).parents[2] / "docs" / "own-estimator.md"


@pytest.fixture(scope="module")
def plugin_file(tmp_path_factory):
    """File with the code of the page."""
    (code,) = re.findall(r"```python\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), flags=re.DOTALL)
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
