"""Estimation of the user's channel on every resource element from the PRS.

The PRS symbols of a slot together touch every subcarrier. The estimate from
them, one number per subcarrier, is noisy. A channel whose paths arrive within the
cyclic prefix is a sum of few basis responses: the first discrete prolate spheroidal
sequences. Projection on these keeps the whole channel and removes most of the noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from isacbench.checked_arrays import Complex, Floats, Integers, Mask
from isacbench.errors import InputError, require
from isacbench.model.numerology import SLOT_SYMBOLS, System, prs_elements

LEAST_CONCENTRATION = 1e-10
"""Least share of its energy within the prefix that a response of the basis has."""

MOST_BESIDES = 48
"""Most basis responses beyond one per delay bin: over ln(n_subcarriers) of them the share falls to 0."""


FEWEST_POINTS = 3
"""Least number of subcarriers for which SciPy computes prolate spheroidal sequences."""


@dataclass(frozen=True, eq=False)
class PrsEstimator:
    """Least-squares estimator of the channel from the PRS.

    The response along frequency is a combination of the columns of `basis`.
    Along time each subcarrier follows a polynomial through the bursts of PRS.

    Attributes
    ----------
    basis : ndarray of complex128, shape (n_subcarriers, n_basis)
        Orthonormal responses of paths that arrive within the prefix.
    bursts : tuple of ndarray of int64
        Symbols of each burst; every subcarrier carries PRS in some of them.
    is_prs : ndarray of bool, shape (n_subcarriers, n_symbols)
    along_time : ndarray of float64, shape (n_symbols, n_bursts) or (1, n_bursts)
        Weight of each burst in the estimate of each symbol; one row where the
        channel is taken as constant.
    """

    basis: Complex
    bursts: tuple[Integers, ...]
    is_prs: Mask
    along_time: Floats

    @property
    def noise_gain(self) -> float:
        """Power of the estimation error over the noise power, mean over the grid.

        It is n_basis / n_prs where the PRS touches all subcarriers equally often
        and the channel is taken as constant.
        """
        leverage = np.sum(np.abs(self.basis) ** 2, axis=1)
        of_burst = [np.mean(leverage / self._count(burst)) for burst in self.bursts]
        return float(np.mean(self.along_time**2 @ of_burst))

    def estimate(self, received: Complex, sent: Complex) -> Complex:
        """Estimate the channel.

        Parameters
        ----------
        received, sent : ndarray of complex128, shape (n_subcarriers, n_symbols)
            Only the elements that carry PRS are read.

        Returns
        -------
        ndarray of complex128, shape (n_subcarriers, n_symbols) or (n_subcarriers, 1)
            One column where the channel is taken as constant.
        """
        raw = np.stack(
            [
                np.sum(received[:, burst] * sent[:, burst].conj(), axis=1, where=self.is_prs[:, burst])
                / self._count(burst)
                for burst in self.bursts
            ]
        )
        # The PRS has unit power: these are the least-squares estimates of each subcarrier on its own.
        projected = (raw @ self.basis.conj()) @ self.basis.T
        by_symbol: Complex = self.along_time @ projected
        return by_symbol.T

    def _count(self, burst: Integers) -> Integers:
        """PRS elements (n_subcarriers,) of a burst."""
        return self.is_prs[:, burst].sum(axis=1)


@lru_cache(maxsize=8, typed=True)
def prs_estimator(system: System, time_order: int = 0) -> PrsEstimator:
    """Build the channel estimator of a frame.

    Parameters
    ----------
    time_order : int
        Order of the polynomial that the channel follows in time: 0 where it
        is constant during the frame. Each further order adds noise.

    Raises
    ------
    InputError
        If the frame has no PRS that touches every subcarrier, or fewer bursts
        of it than the order needs.
    """
    require_estimable(system, time_order)
    is_prs = prs_elements(system)
    bursts = _bursts(is_prs)
    basis = _basis(system.n_subcarriers, system.isi_free_delay_s * system.bandwidth_hz)
    return PrsEstimator(basis, bursts, is_prs, _along_time(system.n_symbols, bursts, time_order))


def require_estimable(system: System, time_order: int = 0) -> None:
    """Refuse what `prs_estimator` cannot estimate, without building it."""
    bursts, prs = _bursts(prs_elements(system)), system.prs
    if not bursts:
        raise InputError(
            f"n_symbols = {system.n_symbols}: the PRS covers every subcarrier only within symbols "
            f"{prs.first_symbol} to {prs.first_symbol + prs.comb - 1} of slot {prs.offset}; "
            f"at least {prs.symbols_to(prs.comb)} symbols are needed"
        )
    allowed = type(time_order) is int and 0 <= time_order < len(bursts)
    limits = f"a whole number below {len(bursts)}, the bursts of PRS in {system.n_symbols} symbols"
    require(allowed, "time_order", time_order, limits)


def _bursts(is_prs: Mask) -> tuple[Integers, ...]:
    """Symbols of the slots in which PRS touches every subcarrier."""
    symbols = np.flatnonzero(is_prs.any(axis=0))
    slots = symbols // SLOT_SYMBOLS
    bursts = [symbols[slots == slot] for slot in np.unique(slots)]
    return tuple(burst for burst in bursts if is_prs[:, burst].any(axis=1).all())


def _along_time(n_symbols: int, bursts: tuple[Integers, ...], order: int) -> Floats:
    """Weights (n_symbols or 1, n_bursts) of the bursts in every symbol: least-squares polynomials."""
    if order == 0:
        return np.full((1, len(bursts)), 1 / len(bursts))
    middle = np.array([burst.mean() for burst in bursts])
    # Times from -1 to 1, for numerical accuracy.
    at_bursts, at_symbols = (
        np.polynomial.chebyshev.chebvander(2 * time / max(n_symbols - 1, 1) - 1, order)
        for time in (middle, np.arange(n_symbols))
    )
    return at_symbols @ np.linalg.pinv(at_bursts)


@lru_cache(maxsize=4)
def _basis(n_subcarriers: int, latest: float) -> Complex:
    """Orthonormal basis (n_subcarriers, n_basis) of the responses of delays from 0 to the latest, in bins.

    It has about one response per delay bin, and a few more for the leakage of
    paths between bins and at the limits.
    """
    width = max(latest, 1.0)
    if width >= n_subcarriers or n_subcarriers < FEWEST_POINTS:
        return np.eye(n_subcarriers, dtype=np.complex128)
    from scipy.signal.windows import dpss  # only where it is needed: its import takes half a second

    n_most = min(int(np.ceil(width)) + MOST_BESIDES, n_subcarriers)
    sequences, concentration = dpss(n_subcarriers, width / 2, n_most, norm=2, return_ratios=True)
    concentrated = sequences[concentration >= LEAST_CONCENTRATION].T
    # The sequences are symmetric about delay 0, the prefix about half of its length.
    turn = np.exp(-1j * np.pi * latest / n_subcarriers * np.arange(n_subcarriers))
    basis: Complex = concentrated * turn[:, None]
    basis.setflags(write=False)
    return basis
