"""Estimators that are objects: in this process and in workers, spelled, sent by their code, known again."""

import dataclasses
import pickle
import sys
from dataclasses import dataclass
from types import ModuleType
from typing import ClassVar

import numpy as np
import pytest

from isacbench import get_detector, get_estimator, run
from isacbench.bench.suites.detection_kind import DetectionSuite
from isacbench.bench.suites.suite import Suite
from isacbench.errors import InputError
from isacbench.model.cloud import PointCloud
from isacbench.plugins.contracts import Detector
from isacbench.plugins.discovery import local_plugins
from isacbench.plugins.instances import Instances, spelled_estimators
from isacbench.plugins.plugin_versions import plugin_version
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


def test_a_run_with_an_object_goes_on_and_knows_other_code(suite, tmp_path):
    run(suite, estimators=[Mine()], trials=1, out=tmp_path / "run")
    assert len(run(suite, estimators=[Mine()], out=tmp_path / "run")) == 2

    @dataclass(frozen=True)
    class Other(Mine):
        def estimate(self, observation):
            return PointCloud.empty()

    with pytest.raises(InputError, match="other versions"):
        run(suite, estimators=[Other()], out=tmp_path / "run")


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
        ([get_detector("ca")], "CaCfar.*: allowed are .* with a name and a method estimate"),
        ([Loaded(np.zeros(2))], "estimator loaded: its parameters must be numbers, texts"),
        ([Mine(), Mine()], "'mine' is listed twice"),
        (["music2d", get_estimator("music2d")], "'music2d' is listed twice"),
        (["music2d[pfa=0.001]", get_estimator("music2d", pfa=1e-3)], "'music2d.pfa=0.001.' is listed twice"),
    ],
)
def test_what_is_no_estimator_is_refused_in_words(suite, estimators, told):
    with pytest.raises(InputError, match=told):
        run(suite, estimators=estimators)


def test_elsewhere_they_come_by_their_code_and_fields_without_a_default_lack_it_still():
    content = pickle.dumps(Instances({"mine": Mine(n=5)}))  # which is then forgotten
    found = pickle.loads(content)["mine"]
    assert (found.n, len(found.estimate(None))) == (5, 5)
    (n,) = [field for field in dataclasses.fields(found) if field.name == "n"]
    assert n.default_factory is dataclasses.MISSING


def _made(source):
    """Class of a module that no file holds, as a notebook has it."""
    module = ModuleType("made_in_a_notebook")
    sys.modules[module.__name__] = module
    exec(source, vars(module))
    return module.Made


MADE = """
from dataclasses import dataclass
from typing import ClassVar

GAIN = 2

def used(x):
    return x in {"a", "b", "c"}

def unused(x):
    return x

@dataclass(frozen=True)
class Made:
    name: ClassVar[str] = "made"
    level = 1

    @property
    def half(self):
        return 0.5

    def estimate(self, observation):
        return used(GAIN)
"""


def test_classes_that_no_file_holds_are_known_by_their_code_and_by_what_it_uses(monkeypatch):
    monkeypatch.setitem(sys.modules, "made_in_a_notebook", None)

    def digest(source):
        (version,) = plugin_version(_made(source)()).values()
        return version["digest"]

    assert digest(MADE) == digest("# moved down\n\n" + MADE)
    assert digest(MADE) == digest(MADE.replace("    return x\n", "    return None\n", 1))
    for old, new in [('"c"', '"d"'), ("level = 1", "level = 2"), ("0.5", "0.25"), ("used(GAIN)", "used(1)")]:
        assert digest(MADE) != digest(MADE.replace(old, new)), old
