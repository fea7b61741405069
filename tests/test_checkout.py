"""One version of isacbench in a checkout, whoever imports."""

import os
import subprocess
import sys

import pytest

from isacbench.link.sensing.observing import observe
from isacbench.model.scenes.scenario import load_scenario
from tests.documents.sources import ROOT


@pytest.fixture
def python(tmp_path):
    """Return a function that runs code in the checkout, where copies of its other packages are installed."""
    for name in ("isacbench_algorithms", "isacbench_scenarios"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("import isacbench\n")

    def run(code):
        environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
        environment.pop("PYTHONSAFEPATH", None)
        return subprocess.run(
            [sys.executable, "-c", code],
            cwd=ROOT,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )

    return run


def test_all_packages_come_from_the_checkout_that_isacbench_comes_from(python):
    done = python(
        "import isacbench, isacbench_algorithms, isacbench_scenarios\n"
        "print(isacbench.__file__, isacbench_algorithms.__file__, isacbench_scenarios.__file__, sep='\\n')"
    )
    expected = [ROOT / folder / "__init__.py" for folder in ("isacbench", "algorithms", "scenarios")]
    assert done.stdout.splitlines() == [str(path) for path in expected], done.stderr


def test_two_versions_in_one_process_are_refused_in_a_line(python):
    done = python("import isacbench_algorithms")
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith("ImportError: two versions of isacbench: ")


def test_what_is_observed_may_be_named():
    named, loaded = observe("single", 10), observe(load_scenario("single"), 10)
    assert (named.cells == loaded.cells).all()
