"""Checks of the arguments of all threshold factors, and the search for the factor of a given rate."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from functools import cache
from numbers import Integral, Real

from scipy import optimize

from isacbench.errors import InputError

LEAST_PFA, MOST_PFA = 1e-30, 0.999999
"""Rates between which factors without a closed form are found."""


def check_pfa(pfa: float) -> None:
    """Refuse a probability of false alarm outside (0, 1).

    Parameters
    ----------
    pfa : float
        Probability of false alarm per cell.

    Raises
    ------
    InputError
        If `pfa` is not a number strictly between 0 and 1.
    """
    if not isinstance(pfa, Real) or not 0 < pfa < 1:
        raise InputError(f"pfa = {pfa!r}: a probability of false alarm lies strictly between 0 and 1")


def check_looks(looks: int) -> None:
    """Refuse a number of looks that is not a whole number of at least one.

    Parameters
    ----------
    looks : int
        Independent noise powers that each cell averages.

    Raises
    ------
    InputError
        If `looks` is not a whole number or is below 1.
    """
    checked_looks(looks)


def checked_looks(looks: int) -> int:
    """Check a number of looks and convert it to int, whose products cannot overflow.

    Parameters
    ----------
    looks : int
        Independent noise powers that each cell averages.

    Raises
    ------
    InputError
        If `looks` is not a whole number or is below 1.
    """
    if not isinstance(looks, Integral) or looks < 1:
        raise InputError(f"looks = {looks!r}: a whole number of averaged powers, at least 1, is allowed")
    return int(looks)


def checked_training(n_training: int) -> int:
    """Check a number of training cells and convert it to int, whose products cannot overflow.

    Parameters
    ----------
    n_training : int
        Number of training cells.

    Raises
    ------
    InputError
        If `n_training` is not a whole number or is below 1.
    """
    if not isinstance(n_training, Integral) or n_training < 1:
        raise InputError(f"n_training = {n_training!r}: at least one training cell is needed")
    return int(n_training)


def checked_factor(factor: float, pfa: float) -> float:
    """Check that a factor is finite.

    Parameters
    ----------
    pfa : float
        Probability of false alarm that it belongs to, for the message.

    Raises
    ------
    InputError
        If `factor` is not finite.
    """
    if not math.isfinite(factor):
        raise InputError(
            f"pfa = {pfa}: the factor overflows float64, take a larger rate or more training cells"
        )
    return factor


def solve_factor(rate: Callable[[float], float], pfa: float, near: float | None = None) -> float:
    """Find the factor of a false-alarm rate, in log-log coordinates, in which the rate is nearly straight.

    Parameters
    ----------
    rate : callable
        False-alarm rate as a decreasing function of the factor.
    pfa : float
        Rate to find, `LEAST_PFA` to `MOST_PFA`.
    near : float, optional
        Guess of the factor, for rates that are slow to compute: few of them
        are computed then, and the factor is found to 1e-10 instead of 1e-13.

    Returns
    -------
    float
        Factor with that rate.

    Raises
    ------
    InputError
        If `pfa` is out of range.
    """
    check_pfa(pfa)
    if not LEAST_PFA <= pfa <= MOST_PFA:
        raise InputError(
            f"pfa = {pfa}: pfa must be from {LEAST_PFA} to {MOST_PFA}, where the numerical threshold factor "
            "is exact"
        )

    @cache  # the root search begins with both ends of the bracket, which are already computed
    def excess(log_factor: float) -> float:
        # A rate that underflows to 0 still tells on which side the root lies.
        return math.log(max(rate(math.exp(log_factor)), sys.float_info.min) / pfa)

    middle, width = (0.0, 1.0) if near is None else (math.log(near), 0.02)
    lower = upper = width
    while excess(middle - lower) < 0:
        lower *= 2
    while excess(middle + upper) > 0:
        upper *= 2
    xtol = 1e-13 if near is None else 1e-10
    return math.exp(optimize.brentq(excess, middle - lower, middle + upper, xtol=xtol))
