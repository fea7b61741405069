"""Image scenes along six axes, each from easy to hard, for the figure and the table of docs/population.md.

Every axis changes one thing at 10 dB, that of pairs at -40 dB. Scenes are developing ones, half of them with
carrier phases.

    python docs/scripts/what_is_hard.py    # eight minutes
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from isacbench import load_scenario, score
from isacbench.bench.kinds.resolution import pair
from isacbench.bench.statistics import student_band
from isacbench.metrics.paper import PROJECTIONS
from isacbench.model.echo import Simulator
from isacbench.model.radio_coordinates import draw_place
from isacbench.model.scene import Scenario
from isacbench.plugins.registry import build_estimator
from isacbench.report.figures import new_figure, save, styled
from isacbench.specifications import spell_spec

LINES = "-", "-.", ":"

FIGURE = Path(__file__).resolve().parents[1] / "images" / "what-is-hard.png"
ESTIMATORS = {name: build_estimator(name) for name in ("fft4d", "music2d", "esprit2d", "nomp4d")}
ORACLE = build_estimator("oracle")
SNR_DB = 10.0
PAIR_SNR_DB = -40.0
"""At 10 dB a pair is 91 dB above the noise after all gains, and most methods tell any two apart."""

SEEDS = range(201, 204)
SCENES = "town", "street"


class Shot(NamedTuple):
    """A scene at one place of an axis; `scene` is the same along the axis."""

    axis: str
    value: float
    scene: str
    scenario: Scenario
    snr_db: float = SNR_DB


AXES = {
    "SNR": "SNR of a resource element [dB]",
    "dynamic range": "range of the objects' powers [dB]",
    "spacing": "two scatterers apart in u or w [Rayleigh cells]",
    "objects": "pedestrians",
    "array errors": "phase error [°], and a tenth of it as gain error [dB]",
    "leakage": "direct path over all echoes [dB]",
}
FALLS_WITH_VALUE = {"dynamic range", "objects", "array errors", "leakage"}


def spelled(family: str, seed: int, **parameters: float) -> str:
    """Spell a scene; every other seed has carrier phases."""
    return spell_spec(family, {"seed": seed, "coherent_phase": seed % 2 == 1, **parameters})


def shots() -> Iterator[Shot]:
    """Scenes along all axes."""
    for family, seed in product(SCENES, SEEDS):
        name = spelled(family, seed)
        scenario = load_scenario(name)
        for snr_db in (-55, -50, -45, -40, -35, -30, -20, 10):
            yield Shot("SNR", snr_db, name, scenario, snr_db)
        # Under the scene's own name, so that noise and errors are the same draws.
        for error_deg in (0, 5, 10, 20, 40):
            erring = replace(scenario, gain_error_db=error_deg / 10, phase_error_deg=float(error_deg))
            yield Shot("array errors", error_deg, name, erring)
        for leakage_db in (20, 40, 50, 60):
            leaky = replace(scenario, array=replace(scenario.array, leakage_db=float(leakage_db)))
            yield Shot("leakage", leakage_db, name, leaky)
    for seed in range(201, 207):
        for range_db in (0, 20, 40, 60):
            scenario = load_scenario(spelled("weak", seed, dynamic_range_db=range_db))
            yield Shot("dynamic range", range_db, f"weak {seed}", scenario)
        for n in (1, 2, 4, 8, 16, 32):
            yield Shot("objects", n, f"crowd {seed}", load_scenario(spelled("crowd", seed, pedestrians=n)))
    single = load_scenario("single")
    for trial, dimension, phase_deg in product(range(4), ("u", "w"), (0, 90)):
        centre = draw_place(single, trial, 0, 1.0)
        for cells in (0.1, 0.2, 0.35, 0.5, 0.7, 1, 1.4):
            name = f"{dimension} {phase_deg} {trial}"
            both = pair(single, name, centre, dimension, cells, phase_deg)
            # Nearer than to the other of the two, so that a point between them is none of them.
            half_m = float(np.linalg.norm(np.diff(both.truth.xyz, axis=0))) / 2
            yield Shot("spacing", cells, name, replace(both, radius_m=half_m), PAIR_SNR_DB)


def measure() -> pd.DataFrame:
    """F-score of every image, of a pair at half its spacing, and Hausdorff sum over that of the oracle."""
    rows, simulator = [], None
    for shot in shots():
        scenario = shot.scenario
        if simulator is None or simulator.scenario is not scenario:
            simulator = Simulator(scenario)
        observation, truth = simulator.observe(shot.snr_db), scenario.truth
        given = {"region": scenario.region, "radius_m": scenario.radius_m}
        best = score(truth, ORACLE.estimate(observation, truth), **given)
        best_m = max(sum(best[column] for column in PROJECTIONS), 0.3)
        for name, estimator in ESTIMATORS.items():
            found = score(truth, estimator.estimate(observation), **given)
            both = found["precision"] + found["recall"]
            f_score = 2 * found["precision"] * found["recall"] / both if both else 0.0
            ratio = sum(found[column] for column in PROJECTIONS) / best_m
            rows.append((shot.axis, shot.value, shot.scene, name, f_score, ratio))
    return pd.DataFrame(rows, columns=["axis", "value", "scene", "estimator", "F", "ratio"])


def draw(rows: pd.DataFrame) -> None:
    """Draw the mean F-score over each axis, one line an estimator, in its 95 % band."""
    with styled():
        figure = new_figure(10.0, 6.0)
        panels = figure.subplots(2, 3, sharey=True).flat
        for panel, (axis, label) in zip(panels, AXES.items(), strict=True):
            for k, name in enumerate(ESTIMATORS):
                own = rows[(rows["axis"] == axis) & (rows["estimator"] == name)].groupby("value")["F"]
                mean, band = own.mean(), student_band(own.std(), own.count())
                panel.plot(
                    mean.index, mean, LINES[k % len(LINES)] + "os^d"[k], color=f"C{k}", ms=4, label=name
                )
                panel.fill_between(
                    mean.index, mean - band, mean + band, color=f"C{k}", alpha=0.12, linewidth=0
                )
            panel.set(title=axis, xlabel=label, ylim=(0, 1.03))
            panel.grid(True)
            if axis == "objects":
                panel.set_xscale("log", base=2)
                panel.set_xticks([1, 2, 4, 8, 16, 32], [1, 2, 4, 8, 16, 32])
        for panel in figure.axes[::3]:
            panel.set_ylabel("F-score at 1 m")
        figure.legend(handles=panel.get_lines(), loc="outside lower center", ncols=4, frameon=False)
        save(figure, FIGURE)


def print_table(rows: pd.DataFrame) -> None:
    """Print what every axis does: from its easy to its hard end, the mean loss with its 95 % interval."""
    print("| axis | from | to | " + " | ".join(f"`{name}`" for name in ESTIMATORS) + " |")
    print("|---|--:|--:|" + "--:|" * len(ESTIMATORS))
    for axis in AXES:
        values = sorted(rows[rows["axis"] == axis]["value"].unique(), reverse=axis not in FALLS_WITH_VALUE)
        cells = []
        for name in ESTIMATORS:
            own = rows[(rows["axis"] == axis) & (rows["estimator"] == name)]
            easy, hard = (own[own["value"] == end].set_index("scene")["F"] for end in (values[0], values[-1]))
            change = hard - easy
            band = float(student_band(change.std(), change.count()))
            ratios = [own[own["value"] == end]["ratio"].median() for end in (values[0], values[-1])]
            cells.append(
                f"{easy.mean():.2f} → {hard.mean():.2f} (Δ {change.mean():+.2f} ± {band:.2f}); "
                f"{ratios[0]:.1f} → {ratios[1]:.1f}"
            )
        print(f"| {axis} | {values[0]:g} | {values[-1]:g} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    measured = measure()
    draw(measured)
    print_table(measured)
    print(measured.pivot_table("F", ["axis", "value"], "estimator", sort=False).round(2).to_string())
