"""Division by the transmitted symbols: weights of echo and noise on every resource element.

A resource element receives Y = X S + N. Division by the symbol X gives

    Ŝ = a S + q N₀,

where N₀ is distributed as N: a phase does not change the distribution of
circular noise. So only the moduli of the symbols matter.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike

from isacbench.checked_arrays import Complex, Floats, Mask
from isacbench.choices import Division, Modulation, Sensing
from isacbench.errors import InputError, require_known, unknown_name
from isacbench.link.waveform.qam import bits_per_symbol
from isacbench.link.waveform.resource_grid import draw_grid, require_n_id
from isacbench.model.numerology import System, resource_elements


@dataclass(frozen=True)
class Signal:
    """Transmitted signal, and how its echo is divided by it.

    Attributes
    ----------
    modulation : {"qpsk", "16qam", "64qam", "256qam"}
        Modulation of the data; the PRS is always QPSK.
    sensing : {"all", "prs"}
        Resource elements used for sensing: the whole grid, or the PRS only.
    division : {"reciprocal", "matched", "wiener"}
        Division of received Y by transmitted X. "reciprocal" is Y/X, which
        amplifies the noise on weak symbols. "matched" is Y X*, which weights
        the echo by the power of the symbols. "wiener" is Y X*/(|X|² + 1/SNR),
        which lies between them and takes the SNR of the echo as known. All
        three are the same where |X| = 1.
    n_id : int
        Identity of the PRS sequence, 0 to 4095.

    Raises
    ------
    InputError
        If a value is not allowed.
    """

    modulation: Modulation = "qpsk"
    sensing: Sensing = "all"
    division: Division = "reciprocal"
    n_id: int = 0

    def __post_init__(self) -> None:
        bits_per_symbol(self.modulation)
        require_known("sensing", self.sensing, get_args(Sensing))
        require_known("division", self.division, get_args(Division))
        require_n_id(self.n_id)

    @property
    def has_unit_modulus(self) -> bool:
        """True if all symbols used for sensing have the same power."""
        return self.sensing == "prs" or self.modulation == "qpsk"

    @property
    def is_plain(self) -> bool:
        """True if the closed form of echo and noise holds after division: all elements, equal powers."""
        return self.sensing == "all" and self.has_unit_modulus


@dataclass(frozen=True, eq=False)
class Weights:
    """Real weights of echo and noise on the resource grid.

    Attributes
    ----------
    echo : ndarray of float64, shape (n_subcarriers, n_symbols)
        a, of mean 1: an echo peaks as high as on the whole grid.
    noise : ndarray of float64, same shape
        q, amplitude of the noise after division over that of the receiver noise.
    """

    echo: Floats
    noise: Floats


def symbol_moduli(system: System, signal: Signal, trial: int = 0, seed: int = 0) -> Floats:
    """Draw the moduli of the symbols used for sensing; 0 on the other resource elements.

    Parameters
    ----------
    trial, seed : int
        Trial and seed of the data.

    Returns
    -------
    ndarray of float64, shape (n_subcarriers, n_symbols)

    Raises
    ------
    InputError
        If no element of the grid is used for sensing.
    """
    sensed = sensed_elements(system, signal.sensing)
    if signal.has_unit_modulus:
        return sensed.astype(np.float64)
    # All elements carry symbols: sensing with the PRS alone has unit modulus.
    grid = draw_grid(system, signal.modulation, trial=trial, seed=seed, n_id=signal.n_id)
    return np.abs(grid.symbols)


def sensed_elements(system: System, sensing: Sensing) -> Mask:
    """Find the resource elements used for sensing, and refuse a grid without any."""
    sensed = resource_elements(system, sensing)
    if not sensed.any():
        raise InputError(
            f"sensing = {sensing!r}: no PRS in a grid of {system.n_subcarriers} subcarriers and "
            f"{system.n_symbols} symbols; at least {system.prs.symbols_to(1)} symbols are needed"
        )
    return sensed


def division_weights(moduli: Floats, division: Division, snr_db: float = np.inf) -> Weights:
    """Compute the weights of echo and noise after a division.

    Parameters
    ----------
    moduli : ndarray of float64, shape (n_subcarriers, n_symbols)
        Moduli of the symbols; 0 where an element is not used for sensing.
    division : {"reciprocal", "matched", "wiener"}
        Y/X; Y X*; or Y X*/(|X|² + 1/SNR).
    snr_db : float
        SNR that Wiener division takes as known. With infinite SNR it becomes
        reciprocal, with a very low SNR matched.
    """
    sensed = moduli > 0
    divisor = np.where(sensed, moduli, 1.0)
    # Both weights follow from the echo weights over the moduli, without a 0/0.
    if division == "reciprocal":
        filter_gain = sensed / divisor
    elif division == "matched":
        filter_gain = moduli
    elif division == "wiener":
        filter_gain = moduli / (divisor**2 + 10 ** (-snr_db / 10))
    else:
        raise unknown_name("division", division, get_args(Division))
    scale = 1 / np.mean(filter_gain * moduli)
    noise = scale * filter_gain
    return Weights(noise * moduli, noise)


def division_factors(
    symbols: ArrayLike, sensed: Mask, division: Division, snr_db: float = np.inf, unit: float | None = None
) -> Complex:
    """Compute the factors that divide received resource elements by the transmitted symbols.

    Parameters
    ----------
    symbols : array_like of complex, shape (n_subcarriers, n_symbols)
        Transmitted symbols, in any unit: not 0 where an element is used for
        sensing, arbitrary elsewhere.
    sensed : ndarray of bool, same shape
        Elements used for sensing.
    division : {"reciprocal", "matched", "wiener"}
    snr_db : float
        SNR of the echo per resource element, for Wiener division, on a symbol
        of amplitude `unit`.
    unit : float, optional
        Amplitude that counts as 1; default: the root mean square of the symbols
        used for sensing.

    Returns
    -------
    ndarray of complex128, same shape
        0 where an element is not used for sensing. The weights of the echo have
        mean 1.
    """
    sent = np.where(sensed, symbols, 1)
    if division == "reciprocal":
        return sensed / (sent * np.mean(sensed))
    moduli = np.abs(sent)
    amplitude = np.sqrt(np.mean(moduli[sensed] ** 2)) if unit is None else unit
    weights = division_weights(np.where(sensed, moduli, 0) / amplitude, division, snr_db)
    factors = (weights.noise / amplitude * sent.conj() / moduli).astype(np.complex128, copy=False)
    return factors
