"""Ambiguity in range and Doppler: the image of one scatterer, sensed with a part of the resource grid.

The PRS leaves gaps along both axes, and gaps have ambiguities. Its comb of four
takes every fourth subcarrier: alone it repeats an echo every N_c/4 range bins.
Four successive symbols fill the comb, so that the repetitions cancel at rest
and show a quarter of the Doppler axis away. Its bursts return every fourth
slot: an echo repeats every N_sym/56 Doppler bins, under the envelope of one
burst.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from isacbench.link.sensing.division import sensed_elements
from isacbench.model.prs import COMB_SIZE, SLOT_PERIOD, SLOT_SYMBOLS

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from isacbench.choices import Sensing
    from isacbench.model.numerology import System

    Complex = NDArray[np.complex128]

CANCELLED = 1e-9
"""Height below which a repetition of an echo is rounding."""


class Ambiguity(NamedTuple):
    """Repetition of an echo at another place.

    Attributes
    ----------
    range_m, speed_mps : float
        Distance from the echo.
    height : float
        Amplitude over that of the echo.
    """

    range_m: float
    speed_mps: float
    height: float


def point_spread(
    system: System, sensing: Sensing, range_offset_bins: ArrayLike, doppler_offset_bins: ArrayLike
) -> Complex:
    """Compute the range-Doppler response to an echo, relative to its peak.

    It is also the correlation of noise between cells.

    Parameters
    ----------
    system : System
    sensing : {"all", "prs"}
    range_offset_bins, doppler_offset_bins : array_like, shapes (r,) and (d,)
        Distances from the echo, fractional ones too.

    Returns
    -------
    ndarray of complex128, shape (r, d)
        1 at the echo itself.

    Raises
    ------
    InputError
        If `sensing` is neither, or no element of the grid is sensed with.

    Examples
    --------
    Four Doppler bins away, at 7.34 m/s, the PRS shows an echo again.

    >>> from isacbench.model.numerology import System
    >>> abs(point_spread(System(), "prs", [0], [0, 2, 4])).round(3).tolist()
    [[1.0, 0.0, 0.927]]
    """
    mask = sensed_elements(system, sensing)
    n_subcarriers, n_symbols = mask.shape
    range_turns = np.outer(np.asarray(range_offset_bins), np.arange(n_subcarriers)) / n_subcarriers
    doppler_turns = np.outer(np.arange(n_symbols), np.asarray(doppler_offset_bins)) / n_symbols
    total = np.exp(2j * np.pi * range_turns) @ mask @ np.exp(-2j * np.pi * doppler_turns)
    spread: Complex = total / mask.sum()
    return spread


def prs_ambiguities(system: System, n_lobes: int = 4) -> list[Ambiguity]:
    """List the repetitions of an echo where the PRS alone is sensed with.

    Parameters
    ----------
    system : System
    n_lobes : int
        Grating lobes along Doppler, of one side.

    Returns
    -------
    list of Ambiguity
        The grating lobes of the repeated bursts, nearest first; then those of
        the comb, by range and by speed, where they are not cancelled.

    Raises
    ------
    InputError
        If the grid has no PRS.

    Examples
    --------
    >>> from isacbench.model.numerology import System
    >>> nearest = prs_ambiguities(System())[0]
    >>> round(nearest.speed_mps, 2), round(nearest.height, 3)
    (7.34, 0.927)
    """
    n, m = system.n_subcarriers, system.n_symbols
    places = [(0.0, lobe * m / (SLOT_PERIOD * SLOT_SYMBOLS)) for lobe in range(1, n_lobes + 1)]
    # Speeds of quarter turns a symbol: the staggered comb repeats every fourth symbol.
    places += [
        (tooth * n / COMB_SIZE, quarter * m / COMB_SIZE)
        for tooth in range(1, COMB_SIZE)
        for quarter in range(-COMB_SIZE // 2, COMB_SIZE // 2)
    ]
    found = [
        Ambiguity(
            range_bins * system.range_bin_m,
            doppler_bins * system.velocity_bin_mps,
            float(np.abs(point_spread(system, "prs", range_bins, doppler_bins)).item()),
        )
        for range_bins, doppler_bins in places
    ]
    return [ambiguity for ambiguity in found if ambiguity.height > CANCELLED]
