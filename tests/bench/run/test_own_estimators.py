"""Estimators that are objects: in this process and in workers, spelled, sent by their code, known again."""

import dataclasses
import pickle
import sys
from dataclasses import dataclass
from threading import Lock
from types import ModuleType
from typing import ClassVar

import numpy as np
import pandas as pd
import pytest

from isacbench import get_detector, get_estimator, run
from isacbench.bench.kinds.detection import DetectionSuite
from isacbench.bench.suites.suite import Suite
from isacbench.errors import InputError
from isacbench.model.cloud import PointCloud
from isacbench.plugins.contracts import Detector
from isacbench.plugins.discovery import local_plugins
from isacbench.plugins.pickling import PickledEstimators
from isacbench.plugins.registry import spelled_estimators
from tests.conftest import PLUGINS


def spread(n):
    """Help an estimator: it has to travel with it."""
    return np.linspace(1, 9, n)


@dataclass(frozen=True)
class Mine:
    """A few points on a line."""

    name: ClassVar[str] = "mine"
    n: int = 3
    limits: tuple[float, ...] = (1.0, 2.0)
    note: str | None = None
    detector: Detector = dataclasses.field(default_factory=lambda: get_detector("ca"))

    def estimate(self, observation):
        along = spread(self.n)
        return PointCloud(np.column_stack([along] * 2 + [along / 2]), along, along)


@pytest.fixture
def suite(tiny):
    return Suite(name="test", scenarios=[str(tiny)], estimators=["oracle"], snr_db=[0], trials=2)


def test_objects_run_beside_names_in_workers(suite):
    records = run(suite, estimators=[Mine(), "oracle", Mine(n=5)], trials=1, jobs=1)
    assert records["reason"].tolist() == ["", "", ""]
    assert records["estimator"].tolist() == ["mine", "oracle", "mine"]
    assert records["n_estimated"].tolist() == [3, 3, 5]
    assert records["time_estimate_s"].notna().all()


def test_plugin_files_have_names_in_the_run_and_are_forgotten_afterwards(suite, write_plugin):
    path = write_plugin("filed.py", PLUGINS)
    asked = {"estimators": ["trouble[kind=empty]"], "plugins": [path]}
    records = run(suite, **asked, trials=1, jobs=1)
    assert records["status"].tolist() == ["no_detection"]
    assert local_plugins() == ()
    # Edited, as in a notebook, it runs again.
    path.write_text(PLUGINS.replace("Goes wrong in a chosen way", "Goes wrong"))
    assert len(run(suite, **asked)) == 2


def test_in_a_suite_of_detectors_an_object_meets_them_all(tiny):
    suite = DetectionSuite(
        kind="detection",
        name="test",
        scenarios=[str(tiny)],
        estimators=["fft4d"],
        detectors=["ca", "os"],
        maps=[],
        snr_db=[0],
        trials=1,
    )
    records = run(suite, estimators=[Mine()])
    assert records["detector"].tolist() == ["ca", "os"]
    assert all(
        f'"name":"{name}"' in params for name, params in zip(["ca", "os"], records["params"], strict=True)
    )


@pytest.mark.parametrize(
    ("estimator", "text"),
    [
        (Mine(), "mine"),
        (Mine(n=5, limits=(3.0,), note="x"), "mine[n=5,limits=(3.0),note=x]"),
        (Mine(detector=get_detector("os", pfa=1e-4)), "mine[detector=os[pfa=0.0001]]"),
    ],
)
def test_objects_are_spelled_by_what_is_not_as_by_default(estimator, text):
    assert list(spelled_estimators([estimator])) == [text]


@dataclass
class Thawed:
    name: ClassVar[str] = "thawed"

    def estimate(self, observation): ...


@dataclass(frozen=True)
class Loaded:
    name: ClassVar[str] = "loaded"
    weights: object = None

    def estimate(self, observation): ...


@pytest.mark.parametrize(
    ("estimators", "told"),
    [
        ("music2d", r"allowed is a list, such as \['music2d'\]"),
        ([Mine], "Mine'>: allowed are .* instances"),
        ([Thawed()], "instances of frozen dataclasses"),
        ([get_detector("ca")], "CaCfar.*: allowed are .* with a name, a word, and a method estimate"),
        ([Loaded(np.zeros(2))], "estimator loaded: weights = array.*: allowed are finite numbers, texts"),
        ([Mine(), Mine()], "'mine' is listed twice"),
        (["music2d", get_estimator("music2d")], "'music2d' is listed twice"),
        (["music2d[pfa=0.001]", get_estimator("music2d", pfa=1e-3)], "'music2d.pfa=0.001.' is listed twice"),
    ],
)
def test_what_is_no_estimator_is_refused_in_words(suite, estimators, told):
    with pytest.raises(InputError, match=told):
        run(suite, estimators=estimators)


def test_elsewhere_they_come_by_their_code_and_fields_without_a_default_lack_it_still():
    content = pickle.dumps(PickledEstimators({"mine": Mine(n=5)}))  # which is then forgotten
    found = pickle.loads(content)["mine"]
    assert (found.n, len(found.estimate(None))) == (5, 5)
    (n,) = [field for field in dataclasses.fields(found) if field.name == "n"]
    assert n.default_factory is dataclasses.MISSING


NOTEBOOK = """
from dataclasses import dataclass
from typing import ClassVar

from isacbench.model.cloud import PointCloud

N = 2

class ByName:
    def __reduce__(self):
        return "KNOWN_HERE"

@dataclass(frozen=True)
class Made:
    name: ClassVar[str] = "made"

    def estimate(self, observation):
        return PointCloud([[1, 2, 3]] * N, [1] * N, [1] * N)
"""


@pytest.fixture
def notebook(monkeypatch):
    """Return a module that no file holds, with a class of an estimator."""
    module = ModuleType("made_in_a_notebook")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    exec(NOTEBOOK, vars(module))
    return module


@pytest.mark.parametrize("jobs", [None, 1])
def test_after_a_run_a_notebook_may_go_on_with_its_edits(suite, notebook, jobs):
    before = dict(vars(notebook.Made))
    asked = {"estimators": [notebook.Made()], "trials": 1, "jobs": jobs}
    assert run(suite, **asked)["n_estimated"].tolist() == [2]
    assert {name: vars(notebook.Made)[name] for name in before} == before
    assert notebook.Made.estimate.__globals__ is vars(notebook)
    notebook.N = 3
    assert run(suite, **asked)["n_estimated"].tolist() == [3]


def test_wherever_it_was_made_a_row_is_of_the_values_at_that_time(suite, notebook, tmp_path):
    asked = {"out": tmp_path / "run", "estimators": [notebook.Made()]}
    run(suite, **asked, trials=1, jobs=1)
    assert len(run(suite, **asked)) == 2
    notebook.N = 3
    for jobs in (None, 1):
        with pytest.raises(InputError, match=r"plugins made_in_a_notebook\.Made digest"):
            run(suite, **asked, jobs=jobs)
    assert run(suite, **asked, rerun=["stale"])["n_estimated"].tolist() == [3, 3]


def test_a_class_of_a_function_goes_on_where_its_run_ended_and_other_code_does_not(suite, tmp_path):
    def made(n=2):
        @dataclass(frozen=True)
        class Inner(Mine):
            def estimate(self, observation):
                return PointCloud([[1, 2, 3]] * n, [1] * n, [1] * n)

        return Inner()

    out = tmp_path / "run"
    first = run(suite, out=out, estimators=[made()], trials=1, jobs=1)
    assert first["status"].tolist() == ["ok"]
    for jobs in (1, None):
        again = run(suite, out=out, estimators=[made()], trials=1, jobs=jobs)
        pd.testing.assert_frame_equal(again, first)
    assert len(run(suite, out=out, estimators=[made()])) == 2
    with pytest.raises(InputError, match="other versions"):
        run(suite, out=out, estimators=[made(3)])


def test_what_cannot_be_sent_or_had_in_a_worker_is_told_in_a_line(suite, notebook):
    notebook.N = Lock()
    with pytest.raises(InputError, match=r"estimator made: cannot be sent .*: leave out jobs"):
        run(suite, estimators=[notebook.Made()], jobs=1)
    notebook.N = notebook.KNOWN_HERE = notebook.ByName()
    with pytest.raises(InputError, match=r"cannot be had in a worker process .*made_in_a_note.*: leave out"):
        run(suite, estimators=[notebook.Made()], jobs=1)
