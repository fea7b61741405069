"""Image the street with noise of the receivers and of the transmitter, and draw it for docs/errata.md.

A scatterer's own cell is the one nearest to it. Other cells are those that the region reaches.

    python docs/scripts/transmitter_noise.py    # a minute
"""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd

from isacbench import load_scenario, score
from isacbench.bench.suites.suite_kinds import load_suite
from isacbench.model.echo import Simulator, echo_parameters
from isacbench.plugins.registry import build_estimator
from isacbench.report.figures import new_figure, save, styled

LINES = "-", "-.", ":"

FIGURE = Path(__file__).resolve().parents[1] / "images" / "transmitter-noise.png"
SCENARIOS = {"receiver": "street", "transmitter": "street-transmitter-noise"}
ESTIMATORS = {
    "music2d": "music2d",
    "fft4d": "fft4d",
    "as printed": load_suite("printed").estimators[0],
}
SNR_DB = range(-80, 25, 5)
TRIALS = 5
PANELS = {"own cells detected": 1, "recall at 1 m": 1, "sum of Hausdorff distances in m": 100}


def measure() -> pd.DataFrame:
    """Detect and image every trial; means by noise, estimator and SNR."""
    rows = []
    for (noise, name), (label, spec) in product(SCENARIOS.items(), ESTIMATORS.items()):
        scenario, estimator = load_scenario(name), build_estimator(spec)
        simulator, echo = Simulator(scenario), echo_parameters(scenario)
        for trial, snr_db in product(range(TRIALS), SNR_DB):
            observation = simulator.observe(snr_db, trial)
            seen, gate = estimator.diagnose(observation), observation.gate
            own = np.zeros(gate.shape, dtype=bool)
            own[
                np.rint(echo.range_bin).astype(int) - gate.range_bins[0],
                np.rint(echo.doppler_bin).astype(int) - gate.doppler_bins[0],
            ] = True
            shown = np.ix_(
                np.isin(gate.range_bins, seen.range_bins), np.isin(gate.doppler_bins, seen.doppler_bins)
            )
            scores = score(scenario.truth, estimator.estimate(observation), region=scenario.region)
            hausdorff_m = [scores[f"hausdorff_{plane}_m"] for plane in ("xy", "xz", "yz")]
            detected = [seen.detection.mask[part[shown]].mean() for part in (own, gate.reachable & ~own)]
            found = (
                *detected,
                scores["recall"],
                scores["precision"],
                scores["n_estimated"],
                sum(hausdorff_m),
            )
            rows.append((noise, label, snr_db, *found))
    own_cells, recall, hausdorff = PANELS
    keys = ["noise", "estimator", "SNR in dB"]
    columns = [*keys, own_cells, "other cells detected", recall, "precision at 1 m", "points", hausdorff]
    return pd.DataFrame(rows, columns=columns).groupby(keys, sort=False).mean()


def draw(means: pd.DataFrame) -> None:
    """Draw a panel for each of three scores: a colour for each estimator, a line for each kind of noise."""
    with styled():
        figure = new_figure(11.0, 3.8)
        for axis, (column, most) in zip(figure.subplots(1, len(PANELS)), PANELS.items(), strict=True):
            for k, (noise, label) in enumerate(product(SCENARIOS, ESTIMATORS)):
                line = means.loc[noise, label][column]
                style = LINES[k // len(ESTIMATORS)] + "os^"[k % len(ESTIMATORS)]
                colour = f"C{k % len(ESTIMATORS)}"
                axis.plot(line.index, line, style, color=colour, ms=3, label=f"{label}, noise of the {noise}")
            axis.set(title=column, xlabel="SNR in dB", ylim=(0, 1.02 * most))
        figure.legend(handles=axis.get_lines(), loc="outside lower center", ncols=2, frameon=False)
        save(figure, FIGURE)


if __name__ == "__main__":
    means = measure()
    draw(means)
    print(means.round(3).to_string())
