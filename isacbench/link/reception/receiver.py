"""Receiver of a user: frames equalised, decided and compared with what was sent; error rates predicted."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, get_args

import numpy as np
from scipy.interpolate import CubicSpline

from isacbench.checked_arrays import Complex, Floats
from isacbench.choices import Modulation
from isacbench.errors import InputError, require, require_known
from isacbench.link.reception.channel import Channel, channel_response
from isacbench.link.reception.channel_estimation import prs_estimator
from isacbench.link.waveform.qam import awgn_ber, bits_per_symbol, decide_bits
from isacbench.link.waveform.resource_grid import ResourceGrid
from isacbench.model.echo import random_stream, white_gaussian
from isacbench.model.number_limits import LARGEST_NOISE_AMPLITUDE
from isacbench.model.numerology import System, prs_elements

Knowledge = Literal["prs", "perfect"]
"""Knowledge that the user has of the channel: an estimate from the PRS, or all."""

LOWEST_SNR_DB = -20 * float(np.log10(LARGEST_NOISE_AMPLITUDE))

MOST_SUMMED = 2**12
"""Elements up to which the closed form is summed for each; beyond, a table of it is interpolated."""

STEP_DB = 0.05
"""Of the table. Cubics through logarithms of error rates are off by less than 1e-7 of them."""

WEAKEST_DB, STRONGEST_DB = -120.0, 120.0
"""Ends of the table, beyond which error rates are constant."""


@dataclass(frozen=True)
class Reception:
    """Errors in the received data of one frame.

    Attributes
    ----------
    n_bits : int
        Data bits of the frame.
    evm : float
        Error vector magnitude: root mean square error of equalised data symbols,
        whose own root mean square is 1.
    channel_power_db : float
        Mean power of the channel over the frame: a fade takes it below 0.
    channel_error_db : float
        Mean square error of the channel estimate over the channel's power;
        NaN where the channel is known.
    """

    n_bits: int
    n_bit_errors: int
    evm: float
    channel_power_db: float
    channel_error_db: float

    @property
    def ber(self) -> float:
        """Bit error rate; NaN of a frame without data."""
        return self.n_bit_errors / self.n_bits if self.n_bits else float("nan")

    @property
    def evm_db(self) -> float:
        """Error vector magnitude in dB."""
        return _db(self.evm**2)


def receive(
    grid: ResourceGrid,
    system: System,
    channel: Channel,
    snr_db: float,
    *,
    knowledge: Knowledge = "prs",
    time_order: int = 0,
    trial: int = 0,
    seed: int = 0,
) -> Reception:
    """Receive a frame with one antenna, without feedback or coding.

    Every resource element is multiplied by the channel, which is what the
    waveform yields as long as all paths arrive within the prefix, and gets
    noise. It is divided by what the user knows of the channel (zero forcing;
    an equaliser of least mean square error differs by a real factor alone, and
    has none left when its bias is taken off), and decided for the nearest
    symbol.

    Parameters
    ----------
    grid : ResourceGrid
        What is sent, for example of `isacbench.link.waveform.resource_grid.draw_grid`.
    snr_db : float
        Mean received power per resource element over noise power, the mean
        taken over all fades of a fading channel; infinity for no noise.
    knowledge : {"prs", "perfect"}
    time_order : int
        Order of the polynomial that the estimated channel follows in time; 0
        takes it as constant.
    trial, seed : int
        Which noise and which fade, not negative. They depend neither on the
        SNR, which only scales the noise, nor on the modulation; the noise not
        on the channel either.

    Raises
    ------
    InputError
        If a value is not allowed, the grid is not of the system, a path is
        later than the prefix allows, or the frame has too little PRS to
        estimate the channel from.

    Examples
    --------
    >>> from isacbench.link.reception.channel import Awgn
    >>> from isacbench.link.waveform.resource_grid import draw_grid
    >>> from isacbench.model.numerology import System
    >>> system = System(n_subcarriers=256)
    >>> reception = receive(draw_grid(system, "16qam"), system, Awgn(), snr_db=30)
    >>> reception.n_bit_errors
    0
    """
    _require_allowed(grid, system, snr_db, knowledge)
    response = _drawn_response(system, channel, trial, seed)
    received = _received(grid.symbols, response, snr_db, trial, seed)
    power = _power(response)
    known, error_db = response, float("nan")
    if knowledge == "prs":
        known = prs_estimator(system, time_order).estimate(received, grid.symbols)
        error_db = _db(_power(known - response) / power)
    # An element without any signal tells nothing: it is taken as 0.
    inverse = np.divide(1, known, out=np.zeros_like(known), where=known != 0)
    equalised = received * inverse
    is_data = ~grid.is_prs.T
    data = equalised.T[is_data]
    decided = decide_bits(data, grid.modulation)
    data -= grid.symbols.T[is_data]
    return Reception(
        n_bits=decided.size,
        n_bit_errors=int(np.count_nonzero(decided != grid.bits)),
        evm=float(np.sqrt(_power(data))),
        channel_power_db=_db(power),
        channel_error_db=error_db,
    )


def _drawn_response(system: System, channel: Channel, trial: int, seed: int) -> Complex:
    """Channel of a trial, as `channel_response` returns it."""
    paths = channel.paths(system, random_stream("channel", trial, seed, channel.name))
    return channel_response(system, paths)


def expected_ber(
    modulation: Modulation,
    system: System,
    channel: Channel,
    snr_db: float,
    *,
    knowledge: Knowledge = "prs",
    time_order: int = 0,
    trial: int = 0,
    seed: int = 0,
) -> float:
    """Predict the bit error rate of `receive`, given the fade and not the noise.

    It is the mean over data elements of the closed form in white noise. An estimate of the channel adds to
    the noise what it takes of it, which holds where it follows the channel. Parameters are as of `receive`.
    """
    response = _drawn_response(system, channel, trial, seed)
    if knowledge == "prs":
        snr_db = effective_snr_db(modulation, snr_db, prs_estimator(system, time_order).noise_gain)
    with np.errstate(divide="ignore"):
        element_snr_db = snr_db + 20 * np.log10(np.abs(response))
    error_rates = awgn_ber if response.size <= MOST_SUMMED else _interpolated_ber
    is_data = ~prs_elements(system)
    n_symbols = is_data.sum(axis=1, keepdims=True) if response.shape[1] == 1 else is_data
    return float(np.average(error_rates(modulation, element_snr_db), weights=n_symbols))


def _interpolated_ber(modulation: Modulation, snr_db: Floats) -> Floats:
    """Interpolate `isacbench.link.waveform.qam.awgn_ber` in a table, for many SNRs."""
    within_db = np.clip(snr_db, WEAKEST_DB, STRONGEST_DB)
    first, last = np.floor(within_db.min() / STEP_DB), np.ceil(within_db.max() / STEP_DB)
    table_db = STEP_DB * np.arange(first, last + 2)
    smallest = np.finfo(np.float64).tiny
    logarithm = CubicSpline(table_db, np.log(np.maximum(awgn_ber(modulation, table_db), smallest)))
    return np.exp(logarithm(within_db))


def effective_snr_db(modulation: Modulation, snr_db: float, noise_gain: float) -> float:
    """Compute the SNR at which a known channel gives the error rate of a noisy channel estimate.

    The estimate is off by e, of power σ² times the noise gain. Its part in phase
    with the channel scales symbols and noise alike, so that thresholds are off in
    proportion to their place: nothing in QPSK, whose only threshold is 0. Its part
    in quadrature turns symbols, which adds the other axis's amplitude to each
    and makes both smaller by the second order. Over all thresholds of L levels an
    axis the noise grows by

        noise_gain ((2L² - 2L - 1) / (2L² - 2) + σ²/2),

    half of the noise gain for QPSK, and nearly all of it for many levels.

    Parameters
    ----------
    noise_gain : float
        Of the estimator, `PrsEstimator.noise_gain`.

    Returns
    -------
    float
        To first order in the noise gain, which is small.

    Examples
    --------
    >>> round(10.0 - effective_snr_db("qpsk", 10.0, 0.02), 3)
    0.048
    """
    n_levels = 2 ** (bits_per_symbol(modulation) // 2)
    share = (2 * n_levels**2 - 2 * n_levels - 1) / (2 * n_levels**2 - 2)
    noise_power = 10 ** (-snr_db / 10)
    return snr_db - 10 * float(np.log10(1 + noise_gain * (share + noise_power / 2)))


def _require_allowed(grid: ResourceGrid, system: System, snr_db: float, knowledge: Knowledge) -> None:
    require(snr_db >= LOWEST_SNR_DB, "snr_db", snr_db, f"{LOWEST_SNR_DB:.0f} and more, infinity for no noise")
    require_known("knowledge", knowledge, get_args(Knowledge))
    shape = (system.n_subcarriers, system.n_symbols)
    if grid.symbols.shape != shape:
        raise InputError(f"grid of shape {grid.symbols.shape}: allowed is {shape}, that of the system")


def _received(symbols: Complex, response: Complex, snr_db: float, trial: int, seed: int) -> Complex:
    """Resource elements (n_subcarriers, n_symbols) as they arrive."""
    received: Complex = symbols * response
    amplitude = 10 ** (-float(snr_db) / 20)
    if amplitude:
        received += amplitude * _unit_noise(symbols.shape, trial, seed)
    return received


@lru_cache(maxsize=1)
def _unit_noise(shape: tuple[int, int], trial: int, seed: int) -> Complex:
    """Noise of the user's receiver; kept, because other SNRs, modulations and channels have the same."""
    noise = white_gaussian(random_stream("user", trial, seed), shape[::-1]).T
    noise.setflags(write=False)
    return noise


def _power(values: Complex) -> float:
    """Mean power; NaN of nothing."""
    if not values.size:
        return float("nan")
    return float(np.mean(values.real**2 + values.imag**2))


def _db(power: float) -> float:
    return 10 * float(np.log10(power)) if power else -float("inf")
