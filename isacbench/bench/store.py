"""The store: a run's folder, complete enough to be scored and drawn again without running again."""

from __future__ import annotations

import dataclasses
import json
import os
import platform
import subprocess
import sys
from contextlib import contextmanager
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_info

import isacbench
from isacbench.bench.record import DRAW_COLUMNS, POINT_COLUMNS, Results
from isacbench.bench.suite import restore_suite
from isacbench.errors import InputError
from isacbench.model.array import VirtualArray
from isacbench.model.frame import Frame, PaperFrame, get_frame
from isacbench.model.numerology import System
from isacbench.model.region import Region
from isacbench.model.scenario import Scatterers, Scenario
from isacbench.registry import distribution, estimator_names

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["default_folder", "read_results", "replacing", "reserve_folder", "write_results"]

RECORDS, RECORDS_CSV = "results.parquet", "results.csv"
CLOUDS, TRUTH, MANIFEST = "clouds.parquet", "truth.parquet", "manifest.json"
DRAWS = "draws.parquet"
PACKAGES = ("numpy", "scipy", "pandas", "pyarrow", "scikit-image", "threadpoolctl")


def default_folder(suite_name: str) -> Path:
    """Return the folder ``results/<suite>-<time>`` of a run that starts now."""
    return Path("results") / f"{suite_name}-{datetime.now():%Y%m%d-%H%M%S}"


@contextmanager
def reserve_folder(folder: Path) -> Iterator[None]:
    """Create a folder at the start of a run, and take it away again if the run leaves it empty.

    Raises
    ------
    InputError
        If the folder exists or cannot be created.
    """
    try:
        folder.mkdir(parents=True)
    except FileExistsError as error:
        raise InputError(f"{folder}: exists; allowed is a new folder, nothing was overwritten") from error
    except OSError as error:
        raise InputError(f"{folder}: cannot be created: {error.strerror}") from error
    try:
        yield
    finally:
        if not any(folder.iterdir()):
            folder.rmdir()


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path that takes the place of `path` once it is written whole."""
    temporary = path.with_name(f".{path.name}.part")
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_results(results: Results, folder: Path) -> None:
    """Write a run into its folder; the manifest comes last, so that its presence means all is there.

    Parameters
    ----------
    results : Results
    folder : Path
        An existing folder.
    """
    truth = pd.concat([_truth_table(scenario) for scenario in results.scenarios.values()], ignore_index=True)
    tables = {RECORDS: results.records, CLOUDS: results.clouds, TRUTH: truth}
    if len(results.draws):
        tables[DRAWS] = results.draws
    for name, table in tables.items():
        with replacing(folder / name) as path:
            table.to_parquet(path, index=False)
    with replacing(folder / RECORDS_CSV) as path:
        results.records.to_csv(path, index=False)
    with replacing(folder / MANIFEST) as path:
        path.write_text(json.dumps(_manifest(results), indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def read_results(folder: Path) -> Results:
    """Read a run back from its folder.

    Raises
    ------
    InputError
        If the folder does not hold a complete run.
    """
    missing = [name for name in (MANIFEST, RECORDS, CLOUDS, TRUTH) if not (folder / name).is_file()]
    if missing:
        raise InputError(
            f"{folder}: not the folder of a run, {', '.join(missing)} missing; "
            "allowed is a folder that isacbench run wrote"
        )
    try:
        manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        truth = pd.read_parquet(folder / TRUTH)
        return Results(
            suite=restore_suite(manifest["suite"]),
            records=pd.read_parquet(folder / RECORDS),
            clouds=pd.read_parquet(folder / CLOUDS),
            scenarios={
                name: _scenario(name, described, truth[truth["scenario"] == name])
                for name, described in manifest["scenarios"].items()
            },
            draws=_draws(folder / DRAWS),
            started=datetime.fromisoformat(manifest["started"]),
            wall_time_s=manifest["wall_time_s"],
            interrupted=manifest["interrupted"],
        )
    except (ValueError, KeyError, OSError) as error:
        raise InputError(f"{folder}: damaged run: {type(error).__name__}: {error}") from error


def _draws(path: Path) -> pd.DataFrame:
    """Scatterers that a study drew; most draw none, and write no file."""
    return pd.read_parquet(path) if path.exists() else pd.DataFrame(columns=DRAW_COLUMNS)


def _manifest(results: Results) -> dict[str, Any]:
    """Everything that a run depended on, in terms of JSON."""
    estimators = results.records[["estimator", "params"]].drop_duplicates()
    return {
        "isacbench": isacbench.__version__,
        "git": _git_state(Path(isacbench.__file__).parent.parent),
        "argv": sys.argv,
        "started": results.started.isoformat(timespec="seconds"),
        "wall_time_s": round(results.wall_time_s, 3),
        "interrupted": results.interrupted,
        "seed": results.suite.seed,
        "suite": results.suite.model_dump(),
        "estimators": [
            {"name": name, "params": json.loads(params), "package": _package(name)}
            for name, params in estimators.itertuples(index=False)
        ],
        "scenarios": {name: _describe(scenario) for name, scenario in results.scenarios.items()},
        "python": platform.python_version(),
        "packages": {name: _version(name) for name in PACKAGES},
        "platform": platform.platform(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "blas_threads": 1,
        "blas": [
            {key: library.get(key) for key in ("user_api", "internal_api", "version", "architecture")}
            for library in threadpool_info()
        ],
    }


def _package(name: str) -> str:
    """Package of an estimator, or of a detector that stands for itself."""
    return distribution("estimator" if name in estimator_names() else "detector", name)


def _describe(scenario: Scenario) -> dict[str, Any]:
    """Describe a scenario without its scatterers, which the truth holds."""
    frame = "paper" if isinstance(scenario.frame, PaperFrame) else "panel"
    return {
        "system": dataclasses.asdict(scenario.system),
        "array": dataclasses.asdict(scenario.array),
        "frame": {"name": frame, **_fields(scenario.frame)},
        "base_station_m": scenario.base_station_m.tolist(),
        "region": dataclasses.asdict(scenario.region),
    }


def _fields(frame: Frame) -> dict[str, float]:
    return {name: getattr(frame, name) for name in getattr(frame, "__dataclass_fields__", ())}


def _scenario(name: str, described: dict[str, Any], truth: pd.DataFrame) -> Scenario:
    """Build the scenario that `_describe` and the truth describe."""
    points = truth[POINT_COLUMNS].to_numpy()
    return Scenario(
        name=name,
        system=System(**described["system"]),
        array=VirtualArray(**{key: _tupled(value) for key, value in described["array"].items()}),
        frame=get_frame(**described["frame"]),
        base_station_m=np.array(described["base_station_m"]),
        region=Region(**{key: _tupled(value) for key, value in described["region"].items()}),
        scatterers=Scatterers(xyz=points[:, :3], velocity=points[:, 3], amplitude=np.sqrt(points[:, 4])),
    )


def _tupled(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def _truth_table(scenario: Scenario) -> pd.DataFrame:
    """One row a scatterer."""
    table = pd.DataFrame(scenario.truth.to_array(), columns=POINT_COLUMNS)
    table.insert(0, "scenario", scenario.name)
    return table


def _git_state(checkout: Path) -> dict[str, Any] | None:
    """Commit and dirty flag of the checkout that the code runs from; None where there is none, or no git."""
    if not (checkout / ".git").exists():
        return None
    try:
        status = subprocess.run(
            ["git", "-C", str(checkout), "status", "--porcelain=v2", "--branch"],
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    lines = status.stdout.splitlines()
    commit = next((line.split()[2] for line in lines if line.startswith("# branch.oid")), None)
    return {"commit": commit, "dirty": any(not line.startswith("#") for line in lines)}


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _processor() -> str:
    """Name of the processor as its maker writes it, where the system tells."""
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
