"""Train the learned detector on generated scenes, and write its weights.

The scenes have development seeds, so that scenes to validate and to report with
stay unseen. Needs scikit-learn, and the package `isacbench_learned` itself.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from isacbench_learned.surroundings import FEATURES, describe_surroundings
from scipy.special import gammainccinv
from sklearn.linear_model import LogisticRegression
from sklearn.preprocessing import SplineTransformer

from isacbench import load_scenario, observe
from isacbench.dsp.cell_detection import power_map, reference_noise
from isacbench.dsp.rangedoppler import GatedMap
from isacbench.model.echo import echo_parameters

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from isacbench.model.scene import Scenario

    Floats = NDArray[np.float64]

FAMILIES = "town", "facade", "crowd", "weak", "street", "sparse", "traffic", "crossing"
OPTIONS = "", ",coherent_phase=true", ",frame=paper", ",frame=paper,coherent_phase=true"
FIRST_SEED = 100
SNRS_DB = -25.0, -15.0, 0.0, 15.0

DYNAMIC_RANGE_DB = 33.0
"""Range below the strongest cells in which estimators ask a detector at most."""

NOMINAL_PFA = 1e-3
"""False-alarm rate at which the learned threshold is the one that separates echoes from leakage best."""

CLEAR_OF_NOISE = 2.0
"""Power over the threshold of white noise from which a cell is an example: noise needs no classifier."""

MISS_COST = 7.0
"""Cost of a missed echo over that of a detected cell without one; later stages drop many of these."""

N_KNOTS = 8


class CellExamples(NamedTuple):
    """Cells to learn from.

    Attributes
    ----------
    log_power : ndarray of float64, shape (n,)
        Logarithm of the cell's power over the reference of its surroundings.
    features : ndarray of float64, shape (n, n_features)
        The surroundings (`describe_surroundings`).
    holds_echo : ndarray of bool, shape (n,)
        True for the nearest cell of a scatterer whose echo is above the noise.
    """

    log_power: Floats
    features: Floats
    holds_echo: NDArray[np.bool_]


def scene_names(n_scenes: int) -> Iterator[str]:
    """Name scenes of all families in turn, then with the next options.

    Parameters
    ----------
    n_scenes : int

    Yields
    ------
    str
    """
    for n in range(n_scenes):
        family, options = FAMILIES[n % len(FAMILIES)], OPTIONS[n // len(FAMILIES) % len(OPTIONS)]
        yield f"{family}[seed={FIRST_SEED + n}{options}]"


def cell_examples(scenario: Scenario, snr_db: float) -> tuple[CellExamples, CellExamples]:
    """Collect the cells of one observation that a classifier has to decide.

    Parameters
    ----------
    scenario : Scenario
    snr_db : float

    Returns
    -------
    (CellExamples, CellExamples)
        Of the power of one element (1 look), and of the mean over the array.
        Cells that hold only echoes below the noise belong to neither class, and are left out.
    """
    observation, echo = observe(scenario, snr_db), echo_parameters(scenario)
    untapered = GatedMap.of(observation, observation.cells)
    gated = untapered.tapered("hann", untapered.doppler_taper("hann"))
    rows = np.rint(echo.range_bin).astype(int) - gated.gate.range_bins[0]
    columns = np.rint(echo.doppler_bin).astype(int) - gated.gate.doppler_bins[0]
    echo_power = np.zeros(gated.gate.shape)
    np.maximum.at(echo_power, (rows, columns), np.abs(echo.gain) ** 2 * observation.system.processing_gain)

    def of_map(power: Floats, looks: int) -> CellExamples:
        noise = reference_noise(power, gated.gate)
        if noise is None:
            raise RuntimeError(f"{scenario.name}: no bin is clear of echoes")
        strongest = np.sort(power[gated.gate.reachable])[-20:].mean()
        least = CLEAR_OF_NOISE * noise * gammainccinv(looks, NOMINAL_PFA) / looks
        asked = gated.gate.reachable & (power > max(least, strongest * 10 ** (-DYNAMIC_RANGE_DB / 10)))
        asked &= (echo_power > noise) | (echo_power == 0)
        reference, features = describe_surroundings(power)
        return CellExamples(np.log(power / reference)[asked], features[asked], echo_power[asked] > 0)

    return of_map(*power_map(gated.cells, "element")), of_map(*power_map(gated.cells, "noncoherent"))


def fit_level(examples: CellExamples, knots: Floats, looks: int) -> Floats:
    """Fit the level above which a cell rather holds an echo than leakage.

    The logit of the classifier is a slope times the logarithm of the cell's
    power, plus a piecewise linear function of each feature. Its zero is a
    threshold on the power.

    Parameters
    ----------
    examples : CellExamples
    knots : ndarray of float64, shape (n_knots, n_features)
    looks : int

    Returns
    -------
    ndarray of float64, shape (n_features, n_knots)
        Contributions to the logarithm of the level at the knots.

    Raises
    ------
    RuntimeError
        If the score does not rise with the power of the cell.
    """
    hats = SplineTransformer(degree=1, knots=knots, extrapolation="constant", include_bias=False)
    inputs = np.column_stack([examples.log_power, hats.fit_transform(examples.features)])
    classifier = LogisticRegression(max_iter=500, class_weight={False: 1.0, True: MISS_COST})
    slope, *weights = classifier.fit(inputs, examples.holds_echo).coef_[0]
    if slope <= 0:
        raise RuntimeError(f"the slope is {slope:.3g}: too few examples, the score must rise with the power")
    # The hats of a feature add up to 1: the last of each is left out, and is 0.
    values = np.pad(-np.reshape(weights, (len(FEATURES), N_KNOTS - 1)) / slope, ((0, 0), (0, 1)))
    values[0] -= classifier.intercept_[0] / slope + np.log(gammainccinv(looks, NOMINAL_PFA) / looks)
    return values


def joined(examples: Iterable[CellExamples]) -> CellExamples:
    """Join examples of several maps.

    Parameters
    ----------
    examples : iterable of CellExamples

    Returns
    -------
    CellExamples
    """
    return CellExamples(*map(np.concatenate, zip(*examples, strict=True)))


def train(n_scenes: int) -> dict[str, Any]:
    """Train on scenes at all SNRs, for one look and for the looks of an array.

    Parameters
    ----------
    n_scenes : int

    Returns
    -------
    dict
        The content of ``weights.json``.
    """
    scenarios = map(load_scenario, scene_names(n_scenes))
    maps = [cell_examples(scenario, snr_db) for scenario in scenarios for snr_db in SNRS_DB]
    one, many = (joined(examples) for examples in zip(*maps, strict=True))
    lowest, highest = np.quantile(np.concatenate([one.features, many.features]), [0.002, 0.998], axis=0)
    knots = np.linspace(lowest, highest, N_KNOTS).round(4)
    values = [fit_level(examples, knots, looks) for examples, looks in ((one, 1), (many, 256))]
    print(f"{n_scenes} scenes, {len(one.log_power)} and {len(many.log_power)} cells")
    return {"features": FEATURES, "knots": knots.T.tolist(), "values": np.round(values, 4).tolist()}


def main() -> None:
    """Train, and write the weights into the package."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--scenes", type=int, default=64)
    parser.add_argument(
        "--output", type=Path, default=Path(__file__).parent / "isacbench_learned/weights.json"
    )
    options = parser.parse_args()
    options.output.write_text(json.dumps(train(options.scenes), indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
