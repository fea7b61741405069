"""A detector whose threshold is a learned function of the surroundings of each cell."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from scipy.optimize import brentq
from scipy.special import gammaincc, gammainccinv

from isacbench.dsp.cfar import checked_power
from isacbench.dsp.cfar.factors import check_pfa
from isacbench.plugins.contracts import Detection

from .surroundings import describe_surroundings

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

__all__ = ["LearnedDetector"]

NOISE_SHAPE = 384, 384
"""Cells of the white noise in which thresholds are calibrated."""

NOISE_SEED = 20240611

MOST_LOOKS = 256
"""Looks of the map that the second set of weights was trained on; the first was trained on one look."""


@dataclass(frozen=True)
class LearnedDetector:
    """Threshold that a classifier of cells has learned on generated scenes, calibrated in white noise.

    The score of a cell is the logarithm of its power, less a learned function of
    its surroundings. A cell is detected where the score exceeds a limit, so where
    its power exceeds a threshold: the learned level times a factor that keeps
    the rate.

    Attributes
    ----------
    pfa : float
        Probability of false alarm per cell in white noise.

    Raises
    ------
    InputError
        If `pfa` is out of range.
    """

    name: ClassVar[str] = "learned"

    pfa: float = 1e-3

    def __post_init__(self) -> None:
        check_pfa(self.pfa)

    def detect(self, power: NDArray[np.floating[Any]], looks: int = 1) -> Detection:
        """Test every cell of a power map.

        Parameters
        ----------
        power : ndarray of real numbers, shape (n_range, n_doppler)
            Power map in any unit; finite and not negative.
        looks : int, default 1
            Independent noise powers that each cell averages.

        Returns
        -------
        Detection
            Its noise is the learned level, in white noise right in the median.

        Raises
        ------
        InputError
            If the map or `looks` is not allowed, or the map is smaller than
            the window.
        """
        power = checked_power(power, looks)
        level = learned_level(power, looks)
        threshold = level * threshold_factor(self.pfa, looks)
        return Detection(power > threshold, threshold, level / np.median(_noise_levels(looks)))


def learned_level(power: Floats, looks: int) -> Floats:
    """Level with which the power of each cell is compared: the noise, or leakage where it is higher.

    The classifier tells echoes from the leakage of others. Noise is left to the
    median of the training cells, which varies less.

    Parameters
    ----------
    power : ndarray of float64, shape (n_range, n_doppler)
    looks : int

    Returns
    -------
    ndarray of float64, shape (n_range, n_doppler)
        In the unit of the power; zeros for a map of zeros.
    """
    if not power.any():
        return np.zeros(power.shape)
    reference, features = describe_surroundings(power)
    weights = _weights()
    share = min(np.log(looks) / np.log(MOST_LOOKS), 1.0)
    values = (1 - share) * weights["values"][0] + share * weights["values"][1]
    log_leakage = np.zeros(power.shape)
    for feature, knots, value in zip(np.moveaxis(features, -1, 0), weights["knots"], values, strict=True):
        log_leakage += np.interp(feature, knots, value)
    return reference * np.exp(np.maximum(log_leakage, 0.0))


@cache
def threshold_factor(pfa: float, looks: int) -> float:
    """Threshold over learned level that keeps the false-alarm rate in white noise.

    The power of a cell is independent of its surroundings. Given these, the rate is
    therefore a gamma law; only its mean over surroundings is taken from simulated noise.

    Parameters
    ----------
    pfa : float
    looks : int

    Returns
    -------
    float
    """
    levels = _noise_levels(looks)

    def excess(log_factor: float) -> float:
        return float(np.log(np.mean(gammaincc(looks, looks * np.exp(log_factor) * levels)) / pfa))

    quantile = gammainccinv(looks, pfa) / looks
    bounds = np.log(quantile / levels.max()), np.log(quantile / levels.min())
    return float(np.exp(brentq(excess, *bounds)))


@cache
def _noise_levels(looks: int) -> Floats:
    """Learned levels in white noise of mean power 1."""
    rng = np.random.default_rng(NOISE_SEED)
    return learned_level(rng.standard_gamma(looks, NOISE_SHAPE) / looks, looks)


@cache
def _weights() -> dict[str, Floats]:
    """Read the weights: knots (n_features, n_knots), and values (2, n_features, n_knots) there."""
    stored = json.loads(files(__package__).joinpath("weights.json").read_text(encoding="utf-8"))
    return {name: np.array(stored[name]) for name in ("knots", "values")}
