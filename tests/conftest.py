"""Shared fixtures: plugins that are really found through entry points, scenes, and a frame of a street."""

import dataclasses
import gc
import itertools
import os
import sys
import time
from functools import cache
from pathlib import Path
from typing import NamedTuple

# Compiling the tests, and what pytest rewrites of hypothesis, is half of their collection: they are kept
# compiled whatever Python was told.
sys.dont_write_bytecode = False

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from threadpoolctl import threadpool_limits

from isacbench.errors import InputError
from isacbench.model.array import VirtualArray
from isacbench.model.echo import resource_grid
from isacbench.model.numerology import Prs
from isacbench.model.scenes.scenario import load_scenario
from isacbench.plugins.discovery import isolated_plugins

# How long an example takes on a busy machine decides no test. The default run tries the same examples each
# time; the scheduled workflow tries others, and more, with --hypothesis-profile=thorough.
settings.register_profile("quick", deadline=None, max_examples=25, derandomize=True)
settings.register_profile("thorough", deadline=None, max_examples=500)
settings.load_profile("quick")


PRS_PAIRS = [(2, 2), (2, 4), (2, 6), (2, 12), (4, 4), (4, 12), (6, 6), (6, 12), (12, 12)]
"""Comb sizes and numbers of symbols of a slot that 3GPP TS 38.211, 7.4.1.7.3, allows together."""

COMB_TURNS = {
    2: [0, 1],
    4: [0, 2, 1, 3],
    6: [0, 3, 1, 4, 2, 5],
    12: [0, 6, 3, 9, 1, 7, 4, 10, 2, 8, 5, 11],
}
"""Relative offsets k' of its table 7.4.1.7.3-1, by comb size."""


@st.composite
def each_prs(draw, pairs=PRS_PAIRS):
    """Draw a PRS that is allowed."""
    comb, n_symbols = draw(st.sampled_from(pairs))
    first, period = draw(st.integers(0, 14 - n_symbols)), draw(st.integers(1, 5))
    return Prs(comb, n_symbols, first, period, draw(st.integers(0, period - 1)))


def few(test):
    """Give a test whose examples take long a fifth of the examples."""
    return settings(max_examples=settings.default.max_examples // 5)(test)


def refusal(call, *args, **options):
    """Message, of one line, with which a call is refused."""
    with pytest.raises(InputError) as refused:
        call(*args, **options)
    assert "\n" not in str(refused.value)
    return str(refused.value)


def slow_but(quick, every):
    """All parameters; those that are not among the quick ones have the marker slow."""
    values = [(one, one if isinstance(one, tuple) else (one,)) for one in every]
    return [pytest.param(*value, marks=() if one in quick else pytest.mark.slow) for one, value in values]


PATIENCE_S = 120
"""Time in s that is enough on any machine, however busy."""


def wait_until(condition):
    """Wait until something has happened elsewhere."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, "it did not come to pass"
        time.sleep(0.05)


MOST_WORKERS = 8

# Tables keep to the width that COLUMNS names; processes of pytest-xdist are told one.
os.environ.pop("COLUMNS", None)


def pytest_xdist_auto_num_workers(config):
    """Run files and single tests in this process, which starts at once, and folders in one process a core.

    One more works while others wait for what they have started.
    """
    asked = [Path(text.partition("::")[0]) for text in config.args]
    return 0 if all(path.is_file() for path in asked) else min((os.cpu_count() or 1) + 1, MOST_WORKERS)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Run tests marked `first` before the others."""
    items.sort(key=lambda item: item.get_closest_marker("first") is None)


def pytest_collection_finish():
    """Leave modules and tests, which stay to the end, out of each garbage collection."""
    gc.freeze()


DRAW_NOTHING = """
if "isacbench.cli.app" in sys.modules and "run" in sys.argv:  # the process of a run, and no worker
    import isacbench.report.run_report
    assert isacbench.report.run_report.draw_with_page
    isacbench.report.run_report.draw_with_page = lambda *_: []
"""
"""Part of a plugin file by which runs in processes of their own draw neither figures nor a page."""

PLUGINS = '''
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from isacbench.plugins.contracts import Detection, Detector
from isacbench.model.cloud import PointCloud


@dataclass(frozen=True)
class Level:
    """Flat threshold."""

    name: ClassVar[str] = "level"
    pfa: float = 1e-3

    def __post_init__(self):
        if not 0 < self.pfa < 1:
            raise ValueError(f"pfa = {self.pfa}: must lie between 0 and 1")

    def detect(self, power, looks=1):
        return Detection(power > 1, np.ones_like(power), np.ones_like(power))


@dataclass(frozen=True)
class Blob:
    """Points around the middle of the region, spread by the noise.

    And a second paragraph.
    """

    name: ClassVar[str] = "blob"
    n: int = 4
    pfa: float | None = None
    mode: Literal["near", "far"] = "near"
    cells: int | tuple[int, int] = 1
    detector: Detector = Level()

    def estimate(self, observation):
        region = observation.region
        middle = (region.lower_m + region.upper_m) / 2
        spread = np.abs(observation.cells.ravel()[: 3 * self.n]).reshape(self.n, 3)
        xyz = np.clip(middle + spread, region.lower_m, region.upper_m)
        return PointCloud(xyz, np.zeros(self.n), np.ones(self.n))


@dataclass(frozen=True)
class Seer:
    """Sees the truth."""

    name: ClassVar[str] = "seer"
    needs_truth: ClassVar[bool] = True

    def estimate(self, observation, truth):
        return truth


@dataclass(frozen=True)
class Trouble:
    """Goes wrong in a chosen way."""

    name: ClassVar[str] = "trouble"
    kind: str = "raise"

    def estimate(self, observation):
        if self.kind == "raise":
            raise ZeroDivisionError("no luck")
        if self.kind == "interrupt":
            raise KeyboardInterrupt
        if self.kind == "write":
            observation.cells[0] = 0
        return PointCloud.empty() if self.kind == "empty" else [1, 2, 3]
'''

ESTIMATOR = '''
import os
import signal
import time
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from isacbench.model.cloud import PointCloud


@dataclass(frozen=True)
class {title}:
    """Sees nothing."""

    name: ClassVar[str] = "{name}"
    deed: str = "none"

    def estimate(self, observation):
        {deed}
        return PointCloud.empty()
'''


def estimator_source(name, deed="pass"):
    """Text of an estimator that does something, line by line, and sees nothing."""
    return ESTIMATOR.format(name=name, title=name.title(), deed=deed.strip().replace("\n", "\n        "))


TINY = """\
# Three points in a small scene.
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
kind = "points"
file = "tiny.csv"
"""

TINY_POINTS = "x,y,z,v,amplitude\n1,2,3,0,1\n5,6,1,10,2\n9,9,2,-10,1\n"


class PluginFolder(NamedTuple):
    """A folder on the import path in which distributions can be installed."""

    path: Path

    def install(self, distribution: str, source: str, **groups: dict[str, str]) -> None:
        """Install a distribution of one module, its entry points given by group: estimators, detectors."""
        module = distribution.replace("-", "_")
        (self.path / f"{module}.py").write_text(source)
        info = self.path / f"{module}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1.0\n")
        lines = []
        for group, names in groups.items():
            lines.append(f"[isacbench.{group}]")
            lines += [f"{name} = {module}:{attribute}" for name, attribute in names.items()]
        (info / "entry_points.txt").write_text("\n".join(lines) + "\n")
        from isacbench.plugins.discovery import _installed

        _installed.cache_clear()


def hide_estimators(monkeypatch):
    """Make all estimators and detectors of packages uninstalled."""
    from isacbench.plugins import discovery

    known = discovery._installed
    monkeypatch.setattr(
        discovery, "_installed", lambda kind, path: known(kind, path) if kind == "metric" else ()
    )


@pytest.fixture(scope="session", autouse=True)
def one_thread():
    """Keep linear algebra on one thread, as runs do: small matrices gain nothing from threads that wait.

    Tests that are about threads set their number themselves.
    """
    # Only libraries that are loaded are limited, and that of scipy is not the one of numpy.
    import scipy.linalg  # noqa: F401

    with threadpool_limits(limits=1):
        yield


@pytest.fixture(scope="session", autouse=True)
def asked_once():
    """Build the commands, and ask git for the state of the checkout, once: both take long.

    However long a run takes, it draws in this process, in which tests have put other functions in place.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("isacbench.report.drawing.START_S", 3600.0)
        if "typer.testing" in sys.modules:
            typer = sys.modules["typer"]
            patch.setattr(typer.testing, "_get_command", cache(typer.main.get_command), raising=False)
        if "isacbench.bench.store.manifest" in sys.modules:
            manifest = sys.modules["isacbench.bench.store.manifest"]
            patch.setattr(manifest, "git_state", cache(manifest.git_state))
        yield


@pytest.fixture
def plugin_folder(tmp_path_factory, monkeypatch):
    """Return an empty folder on the import path; what is imported from it is forgotten afterwards."""
    folder = tmp_path_factory.mktemp("plugins")
    monkeypatch.syspath_prepend(folder)
    return PluginFolder(folder)


@pytest.fixture(scope="session")
def plugin_library(tmp_path_factory):
    """Install the plugins of the fixture `plugins` once: looking for what is installed takes its time."""
    folder = PluginFolder(tmp_path_factory.mktemp("library"))
    names = {"blob": "Blob", "seer": "Seer", "trouble": "Trouble"}
    folder.install("test-plugins", PLUGINS, estimators=names, detectors={"level": "Level"})
    return folder


@pytest.fixture(scope="session")
def plugin_modules():
    """Return a place for the module of these plugins, which keeps what is known of its code."""
    return {}


@pytest.fixture
def plugins(plugin_library, plugin_modules, monkeypatch):
    """Have the estimators blob, seer and trouble, and the detector level, in a folder that stays as it is."""
    monkeypatch.syspath_prepend(plugin_library.path)
    monkeypatch.delitem(sys.modules, "test_plugins", raising=False)
    sys.modules.update(plugin_modules)
    yield plugin_library
    if "test_plugins" in sys.modules:
        plugin_modules["test_plugins"] = sys.modules.pop("test_plugins")


@pytest.fixture
def write_plugin(tmp_path):
    """Return a function that writes a plugin file; what is registered is forgotten afterwards."""

    def write(filename, source):
        path = tmp_path / filename
        path.parent.mkdir(exist_ok=True)
        path.write_text(source)
        return path

    with isolated_plugins():
        yield write


@pytest.fixture
def tiny(tmp_path):
    """Path of a scenario that is simulated in a millisecond."""
    (tmp_path / "tiny.csv").write_text(TINY_POINTS)
    path = tmp_path / "tiny.toml"
    path.write_text(TINY)
    return path


ROOM = """\
# A room with space for one scatterer or two.
name = "room"
[system]
n_subcarriers = 255
n_symbols = 127
[array]
frame = "panel"
tx_shape = [1, 1]
rx_shape = [9, 9]
[base_station]
position_m = [40.0, 80.0, 40.0]
[region]
x_m = [0.0, 80.0]
y_m = [0.0, 30.0]
z_m = [0.0, 80.0]
speed_mps = [-15.0, 15.0]
"""


@pytest.fixture
def room_file(tmp_path):
    """Path of an empty scenario with space for studies of one scatterer or two."""
    path = tmp_path / "room.toml"
    path.write_text(ROOM)
    return path


def _records(scenarios, estimators, snr_db, trials):
    """Rows of a made-up run: deviations fall with the SNR, and trials share noise over the SNRs."""
    import pandas as pd

    cells = pd.MultiIndex.from_product(
        [scenarios, [*snr_db], range(trials), estimators], names=["scenario", "snr_db", "trial", "estimator"]
    )
    table = cells.to_frame(index=False).astype({"snr_db": float})
    rng = np.random.default_rng(5)
    shared = rng.normal(0, 0.3, trials)[table["trial"]]
    rank = table["estimator"].map({name: index for index, name in enumerate(estimators)})
    noise = shared + rng.normal(0, 0.3, len(table))
    return table.assign(
        suite="street",
        params="{}",
        seed=0,
        status="ok",
        reason="",
        n_true=466,
        n_estimated=100,
        deviation=6 + 2 * rank + 10 ** (-table["snr_db"] / 40) + noise,
        recall=0.6 + 0.1 * noise,
        time_estimate_s=0.05 + 0.001 * np.abs(noise),
        environment="e1",
        scenario_content="c-" + table["scenario"],
        timing=False,
    )


@pytest.fixture
def made_run():
    """Return a function that makes up a run: its records and its manifest."""
    from isacbench.bench.kinds.imaging import ImagingKind
    from isacbench.bench.store.manifest import describe_scores
    from isacbench.plugins.scoring import Metrics

    def make(scenarios=("street",), estimators=("fft4d", "music2d"), snr_db=(-20, -5, 10), trials=10):
        records = _records(scenarios, estimators, snr_db, trials)
        lists = {"scenarios": list(scenarios), "estimators": list(estimators), "snr_db": list(snr_db)}
        manifest = {
            "isacbench": "0.1.0",
            "git": {"commit": "0123456789abcdef", "dirty": False},
            "seed": 0,
            "suite": {"name": "street", "kind": "imaging", "trials": trials, **lists},
            "scores": describe_scores(Metrics.of(ImagingKind.metrics), ()),
            "scenarios": {name: {"content": f"c-{name}"} for name in scenarios},
            "environments": {"e1": {"machine": {"processor": "P", "cores": 2}, "versions": {}}},
        }
        return records, manifest

    return make


@pytest.fixture
def scenes_run(made_run):
    """Return a function that makes up a run over scenes of families: `scenes_run(town=20, crowd=4)`."""
    import pandas as pd

    from isacbench.bench.store.run import Run

    four = ("fft4d", "music2d", "esprit2d", "oracle")

    def make(change=lambda records: None, snr_db=(-10, 10), trials=1, estimators=four, **families):
        names = {f"{family}[seed={seed}]": family for family, n in families.items() for seed in range(n)}
        records, manifest = made_run(tuple(names), estimators, snr_db, trials)
        for name, family in names.items():
            manifest["scenarios"][name]["family"] = family
        rng = np.random.default_rng(3)
        difficulty = pd.Series(np.exp(0.3 * rng.normal(size=len(names))), index=list(names))
        records["deviation"] *= records["scenario"].map(difficulty).to_numpy()
        records["precision"] = records["f_score"] = 1 / (1 + records["deviation"])
        for plane in ("xy", "xz", "yz"):
            records[f"hausdorff_{plane}_m"] = records["deviation"] / 4
        records["hausdorff_sum_m"] = 3 * records["deviation"] / 4
        change(records)
        return Run("run", records, manifest)

    return make


@pytest.fixture
def written_run(tmp_path):
    """Return a function that writes records and manifest into a folder, as far as a comparison reads it."""
    import json

    from isacbench.bench.cells.rows import COLUMNS, TYPES

    def write(name, records, manifest):
        folder = tmp_path / name
        folder.mkdir()
        further = [one for one in COLUMNS if one not in records and TYPES[one] == "float64"]
        records = records.reindex(columns=[*records, *further])
        records.to_parquet(folder / "results.parquet", index=False)
        (folder / "manifest.json").write_text(json.dumps(manifest))
        return folder

    return write


@pytest.fixture(scope="session")
def small_street():
    """Return the street on 512 x 56 resource elements and 8 x 6 virtual elements."""
    street = load_scenario("street")
    system = dataclasses.replace(street.system, n_subcarriers=512, n_symbols=56)
    return dataclasses.replace(street, system=system, array=VirtualArray((1, 1), (8, 6)))


@pytest.fixture(scope="session")
def clean_cube(small_street):
    """Return its frame without noise, complex128."""
    grid = resource_grid(small_street, small_street.array.positions)
    cube = grid.reshape(*grid.shape[:2], *small_street.array.shape)
    cube.setflags(write=False)
    return cube


@pytest.fixture(scope="session")
def noisy_cube(clean_cube):
    """Return its frame with noise of power 1, complex128."""
    parts = np.random.default_rng(7).standard_normal((*clean_cube.shape, 2)) * np.sqrt(0.5)
    cube = clean_cube + parts.view(np.complex128)[..., 0]
    cube.setflags(write=False)
    return cube


POPULATION_SCORES = [
    *("density", "velocity_nmse", "deviation", "chamfer_m", "gospa_m", "precision", "recall"),
    *("f_score", "objects_detected", "velocity_error_mps"),
]


@pytest.fixture
def population_rows():
    """Rows of a population: `population_rows(a=error, ...)` with a number, or one a scene, an estimator.

    Eight scenes of a family by turns in both frames, and every second pair with carrier phases. The
    error is a third of each Hausdorff distance's sum and every other score.
    """
    import pandas as pd

    from isacbench.bench.cells.rows import COLUMNS
    from isacbench.bench.kinds.population import PopulationKind

    def rows(families=("town", "sparse"), n_scenes=8, snrs_db=(0.0, 10.0), **errors):
        found = []
        for family, number, snr_db in itertools.product(families, range(n_scenes), snrs_db):
            for estimator, error in errors.items():
                value = np.broadcast_to(error, n_scenes)[number]
                found.append(
                    {
                        **dict.fromkeys(POPULATION_SCORES, value),
                        **dict.fromkeys([f"hausdorff_{plane}_m" for plane in ("xy", "xz", "yz")], value / 3),
                        "hausdorff_sum_m": value,
                        "scenario": f"{family}[seed={number}]",
                        "estimator": estimator,
                        "params": "{}",
                        "snr_db": snr_db,
                        "trial": 0,
                        "status": "ok",
                        "reason": "",
                        "n_true": 5,
                        "n_estimated": 10,
                        "time_estimate_s": 0.1,
                        "timing": False,
                        **PopulationKind.columns,
                        "family": family,
                        "frame": ("panel", "paper")[number % 2],
                        "coherent_phase": number % 4 >= 2,
                        "n_resolvable": 5 if family == "sparse" else 0,
                    }
                )
        return pd.DataFrame(found).reindex(
            columns=list(dict.fromkeys([*COLUMNS, *PopulationKind.columns, *POPULATION_SCORES]))
        )

    return rows
