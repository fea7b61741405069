"""Image street and towns with transmitters that take turns, and print the table of docs/model.md.

python docs/scripts/taking_turns.py    # a minute
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from isacbench import load_scenario, score
from isacbench.model.echo import Simulator
from isacbench.plugins.registry import build_estimator

SCENES = {"street": ["street"], "five towns": [f"town[seed={seed}]" for seed in range(101, 106)]}
ESTIMATORS = {name: build_estimator(name) for name in ("music2d", "fft4d")}
MODES = ("ideal", "comb", "tdm")
SNR_DB = (-35.0, -20.0, 10.0)
TRIALS = 5


def measure(name: str, mimo: str) -> np.ndarray:
    """Recall, precision and Hausdorff sum (estimators, SNRs, 3) of a scene, means over trials."""
    scenario = load_scenario(name)
    # Under the scene's own name, so that all modes have the same draw of noise.
    simulator = Simulator(replace(scenario, array=replace(scenario.array, mimo=mimo)))
    found = np.zeros((len(ESTIMATORS), len(SNR_DB), 3))
    for (k, estimator), (i, snr_db), trial in product(
        enumerate(ESTIMATORS.values()), enumerate(SNR_DB), range(TRIALS)
    ):
        cloud = estimator.estimate(simulator.observe(snr_db, trial))
        scores = score(scenario.truth, cloud, region=scenario.region)
        hausdorff_m = sum(scores[f"hausdorff_{plane}_m"] for plane in ("xy", "xz", "yz"))
        found[k, i] += np.array([scores["recall"], scores["precision"], hausdorff_m]) / TRIALS
    return found


def main() -> None:
    """Print a row for each scene, estimator and mode."""
    print("| scenes | estimator | `mimo` | " + " | ".join(f"{snr_db:g} dB" for snr_db in SNR_DB) + " |")
    print("|---" * (3 + len(SNR_DB)) + "|")
    for scenes, names in SCENES.items():
        means = {mimo: np.mean([measure(name, mimo) for name in names], axis=0) for mimo in MODES}
        for (k, estimator), mimo in product(enumerate(ESTIMATORS), MODES):
            cells = [
                f"{recall:.2f}, {precision:.2f}, {metres:.1f}" for recall, precision, metres in means[mimo][k]
            ]
            print(f"| {scenes} | `{estimator}` | `{mimo}` | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
