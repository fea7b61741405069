"""Figures of merit of the waveform: time, band, peaks and bit rates."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy.fft
from scipy.special import lambertw, xlogy

from isacbench.checked_arrays import checked_array
from isacbench.choices import Modulation
from isacbench.errors import InputError, require
from isacbench.link.waveform.ofdm import SymbolLayout, layout
from isacbench.link.waveform.power_spectrum import occupied_bandwidth_hz, out_of_band_db
from isacbench.link.waveform.qam import bits_per_symbol
from isacbench.link.waveform.resource_grid import draw_grid
from isacbench.model.number_limits import require_all, require_count
from isacbench.model.prs import prs_elements

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    from isacbench.model.numerology import System

    Floats = NDArray[np.float64]

OFFSETS = (1, 10, 100, 1000)
"""Subcarrier spacings beyond the edge of the band at which out-of-band levels are given."""

MOST_CROSSINGS_AT = 0.5
"""Power over its mean at which an envelope of Gaussian samples crosses upwards most often."""


@dataclass(frozen=True)
class WaveformMerits:
    """Figures of merit of a waveform that do not depend on its data.

    Attributes
    ----------
    layout : SymbolLayout
        Samples of a symbol at the critical rate.
    sampling_rate_hz : float
        Critical rate N Δf.
    symbol_time_s, prefix_s, suffix_s : float
        Symbol with its prefix, and parts of it.
    frame_duration_s : float
        From the start of a frame to that of the next.
    isi_free_range_m : float
        Range up to which echoes stay inside the undisturbed prefix.
    prs_share : float
        Share of the resource elements that carry the PRS.
    occupied_bandwidth_hz : float
        Bandwidth with 99 % of the power.
    out_of_band_db : tuple of float
        Power density outside the band over that inside, in dB, at `OFFSETS`.
    plain_out_of_band_db : tuple of float
        The same of a waveform without a suffix.
    """

    layout: SymbolLayout
    sampling_rate_hz: float
    symbol_time_s: float
    prefix_s: float
    suffix_s: float
    frame_duration_s: float
    isi_free_range_m: float
    prs_share: float
    occupied_bandwidth_hz: float
    out_of_band_db: tuple[float, ...]
    plain_out_of_band_db: tuple[float, ...]


def waveform_merits(system: System) -> WaveformMerits:
    """Compute the figures of merit of a waveform in closed form.

    Parameters
    ----------
    system : System

    Returns
    -------
    WaveformMerits

    Raises
    ------
    InputError
        If prefix or suffix are no whole number of samples.
    """
    parts = layout(system)
    offsets_hz = system.subcarrier_spacing_hz * np.array(OFFSETS)
    return WaveformMerits(
        layout=parts,
        sampling_rate_hz=system.bandwidth_hz,
        symbol_time_s=system.symbol_time_s,
        prefix_s=system.cyclic_prefix_ratio / system.subcarrier_spacing_hz,
        suffix_s=system.cyclic_suffix_ratio / system.subcarrier_spacing_hz,
        frame_duration_s=system.n_symbols * system.symbol_time_s,
        isi_free_range_m=system.isi_free_range_m,
        prs_share=float(prs_elements(system).mean()),
        occupied_bandwidth_hz=occupied_bandwidth_hz(system),
        out_of_band_db=tuple(out_of_band_db(system, offsets_hz).tolist()),
        plain_out_of_band_db=tuple(out_of_band_db(without_suffix(system), offsets_hz).tolist()),
    )


def draw_papr_db(
    system: System,
    modulation: Modulation,
    n_frames: int,
    *,
    seed: int = 0,
    drawn: Callable[[], object] | None = None,
) -> NDArray[np.float64]:
    """Draw frames, and measure the peak-to-average power ratios of their symbols.

    They are sampled at four times the critical rate.

    Parameters
    ----------
    system : System
    modulation : {"qpsk", "16qam", "64qam", "256qam"}
        Of the data; the PRS lies between it.
    n_frames : int
    seed : int
        Seed of the data, not negative.
    drawn : callable, optional
        Called after every frame.

    Returns
    -------
    ndarray of float64, shape (n_frames * n_symbols,)

    Raises
    ------
    InputError
        If a value is not allowed.
    """
    require_count("n_frames", n_frames)
    papr_db = []
    for trial in range(n_frames):
        papr_db.append(symbol_papr_db(draw_grid(system, modulation, trial=trial, seed=seed).symbols))
        if drawn is not None:
            drawn()
    return np.concatenate(papr_db)


def without_suffix(system: System) -> System:
    """Leave the suffix, and with it the smooth window, out of a system.

    Parameters
    ----------
    system : System

    Returns
    -------
    System
    """
    return replace(system, cyclic_suffix_ratio=0.0)


@dataclass(frozen=True)
class FrameRates:
    """Bits that frames sent one after the other carry, free of errors.

    Attributes
    ----------
    n_data_bits : int
        Bits of the elements that the PRS leaves.
    bit_rate_bps : float
        Data bits over the time of all symbols with their prefixes; a suffix overlaps
        the next prefix.
    """

    n_data_bits: int
    bit_rate_bps: float

    def achievable_rate_bps(self, ber: ArrayLike) -> NDArray[np.float64]:
        """Compute the rate up to which a code could make the decided bits free of errors.

        Parameters
        ----------
        ber : array_like, any shape
            Bit error rate of independent errors, from 0 to 1.

        Returns
        -------
        ndarray of float64, same shape

        Raises
        ------
        InputError
            If a rate is not from 0 to 1.
        """
        rate: NDArray[np.float64] = self.bit_rate_bps * hard_decision_capacity(ber)
        return rate


def frame_rates(system: System, modulation: Modulation) -> FrameRates:
    """Count the bits of a frame, and its bit rate.

    Parameters
    ----------
    system : System
    modulation : {"qpsk", "16qam", "64qam", "256qam"}

    Returns
    -------
    FrameRates

    Raises
    ------
    InputError
        If there is no such modulation.

    Examples
    --------
    >>> from isacbench.model.numerology import System
    >>> rates = frame_rates(System(), "256qam")
    >>> rates.n_data_bits, round(rates.bit_rate_bps / 1e9, 3)
    (3473408, 2.977)
    """
    n_data_bits = bits_per_symbol(modulation) * int((~prs_elements(system)).sum())
    return FrameRates(n_data_bits, n_data_bits / (system.n_symbols * system.symbol_time_s))


def hard_decision_capacity(ber: ArrayLike) -> NDArray[np.float64]:
    """Compute the information that a decided bit carries: the capacity of the binary symmetric channel.

    Parameters
    ----------
    ber : array_like, any shape
        Bit error rate, from 0 to 1.

    Returns
    -------
    ndarray of float64, same shape
        In bits, from 0 to 1.

    Raises
    ------
    InputError
        If a rate is not from 0 to 1.

    Examples
    --------
    >>> hard_decision_capacity([0.0, 0.5, 0.11]).round(3).tolist()
    [1.0, 0.0, 0.5]
    """
    rate = checked_array("ber", ber)
    require_all("ber", rate, (rate >= 0) & (rate <= 1), "numbers from 0 to 1")
    entropy = -(xlogy(rate, rate) + xlogy(1 - rate, 1 - rate)) / np.log(2)
    capacity: NDArray[np.float64] = 1 - entropy
    return capacity


def symbol_papr_db(symbols: ArrayLike, oversampling: int = 4) -> Floats:
    """Measure the peak-to-average power ratio of every OFDM symbol.

    Parameters
    ----------
    symbols : array_like, shape (n_subcarriers, n_symbols)
        Resource grid. It is fastest where the subcarriers of a symbol lie side
        by side in memory.
    oversampling : int
        Samples over the critical number: at 1 peaks between them are missed,
        at 4 about 0.05 dB of their height is.

    Returns
    -------
    ndarray of float64, shape (n_symbols,)
        Largest power of the useful part, in dB over the mean power of all
        symbols. The prefix repeats samples of it.

    Raises
    ------
    InputError
        If the grid has no two axes, is empty or not finite, or carries no
        power.

    Examples
    --------
    >>> symbol_papr_db(np.ones((16, 1))).round(2).tolist()
    [12.04]
    """
    require_count("oversampling", oversampling)
    grid = checked_array("symbols", symbols, np.complex128)
    if grid.ndim != 2 or grid.size == 0:
        raise InputError(
            f"symbols of shape {grid.shape}: allowed are subcarriers by symbols, at least one each"
        )
    mean = float(np.mean(grid.real**2 + grid.imag**2))
    require(0 < mean < np.inf, "mean power of the symbols", mean, "a positive number")
    samples = scipy.fft.ifft(grid.T, oversampling * len(grid), axis=1, norm="forward")
    peak = (samples.real**2 + samples.imag**2).max(axis=1) / len(grid)
    papr_db: Floats = 10 * np.log10(peak / mean)
    return papr_db


def papr_ccdf(papr_db: ArrayLike, n_subcarriers: int, *, oversampled: bool = True) -> Floats:
    """Probability that the peak-to-average power ratio of a symbol is exceeded, for Gaussian samples.

    Symbols of many subcarriers have samples that are nearly Gaussian, whatever
    the constellation. At the critical rate the samples are independent, and
    one of N exceeds γ with the probability 1 - (1 - exp(-γ))^N. Of the
    continuous envelope N √(πγ/3) exp(-γ) upward crossings of a high level γ
    are expected, of a process with a flat spectrum; rare crossings are
    Poisson.

    Parameters
    ----------
    papr_db : array_like, any shape
    n_subcarriers : int
    oversampled : bool
        Of the continuous envelope, not of samples at the critical rate. It
        is meant for rare peaks, and is taken constant below -3 dB, the level
        of most crossings.

    Returns
    -------
    ndarray of float64, same shape

    References
    ----------
    Ochiai and Imai, "On the distribution of the peak-to-average power ratio in
    OFDM signals", IEEE Trans. Commun. 49 (2001); crossings by Rice, "Statistical
    properties of a sine wave plus random noise", Bell Syst. Tech. J. 27 (1948).

    Examples
    --------
    >>> papr_ccdf([10.0, 12.0], 2048, oversampled=False).round(6).tolist()
    [0.088789, 0.000268]
    """
    power = 10 ** (checked_array("papr_db", papr_db) / 10)
    if oversampled:
        power = np.maximum(power, MOST_CROSSINGS_AT)
        expected = n_subcarriers * np.sqrt(np.pi / 3 * power) * np.exp(-power)
    else:
        with np.errstate(divide="ignore"):
            expected = -n_subcarriers * np.log1p(-np.exp(-power))
    probability: Floats = -np.expm1(-expected)
    return probability


def exceeded_papr_db(probability: float, n_subcarriers: int) -> float:
    """Invert `papr_ccdf` of the continuous envelope: the ratio that a share of the symbols exceeds.

    Parameters
    ----------
    probability : float
        Between 0 and 1.
    n_subcarriers : int

    Returns
    -------
    float
        In dB.

    Raises
    ------
    InputError
        If there is no such ratio.

    Examples
    --------
    >>> round(exceeded_papr_db(1e-3, 2048), 2)
    12.02
    """
    require(0 < probability < 1, "probability", probability, "a number between 0 and 1")
    expected = -np.log1p(-probability) / n_subcarriers
    # γ exp(-2γ) is known, and γ at least 1/2: the lower branch of Lambert's function.
    known = 3 / np.pi * expected**2
    allowed = bool(2 * known <= np.exp(-1))
    require(allowed, "probability", probability, f"one that {n_subcarriers} subcarriers exceed at some level")
    return float(10 * np.log10(-lambertw(-2 * known, -1).real / 2))
