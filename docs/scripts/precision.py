"""Measure what single precision does to every estimator's curves, and write it into docs/precision.md.

Each estimator images the three streets over SNR, in double and with more and
more stages in single precision. The effect is the largest relative distance of
the two mean curves, of each component of the deviation. Run times are compared
image by image, one setting after the other in the same process, on one thread.

    python docs/scripts/precision.py --trials 6 --jobs 2
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import product
from pathlib import Path
from time import perf_counter, process_time

import numpy as np

from isacbench import get_estimator, load_scenario
from isacbench.model.echo import Simulator
from isacbench.plugins.contracts import Estimator
from isacbench.plugins.scoring import score

PAGE = Path(__file__).resolve().parents[1] / "precision.md"
START, END = "<!-- precision: written by docs/scripts/precision.py -->", "<!-- end -->"

ESTIMATORS = (
    "music2d",
    "music2d[integration=element]",
    "fft4d",
    "fft4d[integration=element]",
    "esprit2d",
    "music2d_joint",
    "nomp4d",
)
SCENARIOS = ("street", "street-paper", "street-coherent")
SNRS_DB = tuple(range(-30, 21, 5))
COMPONENTS = ("hausdorff_xy_m", "hausdorff_xz_m", "hausdorff_yz_m", "density", "velocity_nmse")
LIMIT = 1e-3

SETTINGS = {
    "double": frozenset(),
    "input": frozenset(),
    "detection": frozenset({"detection"}),
    "+ directions": frozenset({"detection", "directions"}),
    "+ selection": frozenset({"detection", "directions", "selection"}),
    "+ subspace": frozenset({"detection", "directions", "selection", "subspace"}),
}
"""Stages in single precision; of "input" the cells are rounded and all else is double."""


def estimator_in(setting: str, name: str) -> Estimator | None:
    """Estimator with the stages of a setting in single precision, None where it has no such stages."""
    bare, _, parameters = name.rstrip("]").partition("[")
    given = dict(pair.split("=") for pair in parameters.split(",") if pair)
    kind = type(get_estimator(bare))
    if not hasattr(kind, "single_stages"):
        return kind(**given) if not SETTINGS[setting] else None
    added = setting.removeprefix("+ ")
    if added in {"music2d": ("selection",), "fft4d": ("selection", "subspace")}.get(bare, ()):
        return None
    partly = type(kind.__name__, (kind,), {"single_stages": SETTINGS[setting]})
    return partly(**given, precision="single" if SETTINGS[setting] else "double")


def measure(name: str, scenario_name: str, n_trials: int, settings: list[str]) -> np.ndarray:
    """Components of the deviation and time, shape (settings, SNRs, trials, components + 1); nan without."""
    scenario = load_scenario(scenario_name)
    simulator, limits = Simulator(scenario), {"region": scenario.region}
    limits["velocity_bin_mps"] = scenario.system.velocity_bin_mps
    estimators = [estimator_in(setting, name) if setting in settings else None for setting in SETTINGS]
    values = np.full((len(SETTINGS), len(SNRS_DB), n_trials, len(COMPONENTS) + 1), np.nan)
    # Trials outside, so that their noise is drawn once.
    for trial, (i, snr_db) in product(range(n_trials), enumerate(SNRS_DB)):
        observation = simulator.observe(float(snr_db), trial)
        rounded = replace(observation, cells=observation.cells.astype(np.complex64).astype(np.complex128))
        for j, (setting, estimator) in enumerate(zip(SETTINGS, estimators, strict=True)):
            if estimator is None:
                continue
            seen = rounded if setting == "input" else observation
            start = process_time()
            cloud = estimator.estimate(seen)
            time_s = process_time() - start
            found = score(scenario.truth, cloud, **limits)
            values[j, i, trial] = [*(found[component] for component in COMPONENTS), time_s]
    return values


def effects(values: np.ndarray) -> np.ndarray:
    """Largest relative distance of the mean curves from those in double, shape (settings, components)."""
    curves = values[..., :-1].mean(axis=2)
    return np.max(np.abs(curves - curves[0]) / curves[0], axis=1)


def time_ratios(values: np.ndarray) -> np.ndarray:
    """Median ratio of run times to those in double, shape (settings,)."""
    times_s = values[..., -1].reshape(len(SETTINGS), -1)
    return np.median(times_s / times_s[0], axis=1)


def report(measured: dict[tuple[str, str], np.ndarray], n_trials: int) -> Iterator[str]:
    """Table in Markdown."""
    yield (
        f"{n_trials} trials at {len(SNRS_DB)} SNRs from {SNRS_DB[0]} to {SNRS_DB[-1]} dB. Largest relative "
        "effect on the mean curve in per cent, bold where it is not below 0.1; median ratio of run times.\n\n"
    )
    yield "| estimator | scenario | single | xy | xz | yz | density | NMSE | time |\n"
    yield "|---" * 9 + "|\n"
    for (name, scenario), values in measured.items():
        rows = zip(SETTINGS, effects(values), time_ratios(values), strict=True)
        for setting, effect, ratio in rows:
            if setting == "double" or np.isnan(ratio):
                continue
            cells = (f"**{100 * e:.2f}**" if e >= LIMIT else f"{100 * e:.3f}" for e in effect)
            time = "" if setting == "input" else f"{ratio:.2f}"
            yield f"| {name} | {scenario} | {setting} | " + " | ".join(cells) + f" | {time} |\n"


def main() -> None:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--trials", type=int, default=6)
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--estimators", nargs="+", default=ESTIMATORS)
    parser.add_argument("--settings", nargs="+", default=list(SETTINGS), help="double, and others")
    parser.add_argument("--raw", type=Path, help="file for all values, as JSON")
    given = parser.parse_args()
    start = perf_counter()
    blocks = list(product(given.estimators, SCENARIOS))
    with ProcessPoolExecutor(given.jobs) as pool:
        tasks = {block: pool.submit(measure, *block, given.trials, given.settings) for block in blocks}
        measured = {block: task.result() for block, task in tasks.items()}
    if given.raw:
        given.raw.write_text(json.dumps({"/".join(k): v.tolist() for k, v in measured.items()}))
    text = "".join(report(measured, given.trials))
    if PAGE.exists():
        page = PAGE.read_text(encoding="utf-8")
        before, _, rest = page.partition(START)
        after = rest.partition(END)[2]
        PAGE.write_text(f"{before}{START}\n\n{text}\n{END}{after}", encoding="utf-8")
    print(text)
    print(f"{perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main()
