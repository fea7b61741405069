"""The OFDM numerology and everything that follows from it, and the positioning reference signal (PRS).

The PRS is a comb of subcarriers on some symbols of some slots. Symbols of a slot take turns in
the comb, so that as many successive ones as its size touch every subcarrier.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import get_args

import numpy as np

from isacbench.checked_arrays import Mask
from isacbench.choices import NoiseSource, Sensing
from isacbench.errors import require, unknown_name
from isacbench.model.number_limits import require_count

SPEED_OF_LIGHT_MPS = 299_792_458.0

SLOT_SYMBOLS = 14

COMB_OFFSETS = {
    2: (0, 1),
    4: (0, 2, 1, 3),
    6: (0, 3, 1, 4, 2, 5),
    12: (0, 6, 3, 9, 1, 7, 4, 10, 2, 8, 5, 11),
}
"""First subcarrier on successive PRS symbols, counted from the first of a slot, by comb size."""

PRS_SYMBOLS = {2: (2, 4, 6, 12), 4: (4, 12), 6: (6, 12), 12: (12,)}
"""Numbers of PRS symbols that a slot may have, by comb size: multiples of it."""


@dataclass(frozen=True)
class Prs:
    """Positioning reference signal: a comb of subcarriers that is staggered over the symbols of a slot.

    Attributes
    ----------
    comb : {2, 4, 6, 12}
        Subcarriers from one PRS element of a symbol to the next.
    n_symbols : int
        Successive PRS symbols of a slot: 2, 4, 6 or 12 for comb 2, 4 or 12 for
        comb 4, 6 or 12 for comb 6, 12 for comb 12.
    first_symbol : int
        First of them, counted from 0; the slot has 14 symbols.
    period : int
        Slots from one slot with PRS to the next. The standard has periods of 4
        slots and more, and repeats a resource within one, at gaps from 1 slot up.
        This number stands for both; that the repetition ends is not modelled.
    offset : int
        First slot with PRS, below the period.

    Raises
    ------
    InputError
        If a number is not allowed.

    References
    ----------
    3GPP TS 38.211, 7.4.1.7.3 and 7.4.1.7.4.
    """

    comb: int = 4
    n_symbols: int = 12
    first_symbol: int = 1
    period: int = 4
    offset: int = 0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            require(type(value) is int, f"prs.{field.name}", value, "a whole number")
        require(self.comb in PRS_SYMBOLS, "prs.comb", self.comb, "2, 4, 6 or 12")
        n_symbols = PRS_SYMBOLS[self.comb]
        limits = f"{' or '.join(map(str, n_symbols))} with comb {self.comb}"
        require(self.n_symbols in n_symbols, "prs.n_symbols", self.n_symbols, limits)
        last = SLOT_SYMBOLS - self.n_symbols
        limits = f"from 0 to {last}, so that {self.n_symbols} symbols fit into the slot"
        require(0 <= self.first_symbol <= last, "prs.first_symbol", self.first_symbol, limits)
        require_count("prs.period", self.period)
        limits = f"from 0 to {self.period - 1}, below the period"
        require(0 <= self.offset < self.period, "prs.offset", self.offset, limits)

    def symbols_to(self, n: int) -> int:
        """Count the symbols of a frame up to the n-th PRS symbol of its first slot with PRS."""
        return SLOT_SYMBOLS * self.offset + self.first_symbol + n


@dataclass(frozen=True)
class System:
    """OFDM numerology of the downlink frame, defaults from the paper's Table I.

    Attributes
    ----------
    carrier_hz : float
        Carrier frequency f_c.
    subcarrier_spacing_hz : float
        Subcarrier spacing Δf.
    n_subcarriers : int
        Subcarriers N_c of the resource grid.
    n_symbols : int
        OFDM symbols N_sym of the frame.
    cyclic_prefix_ratio : float
        Cyclic prefix as a fraction of the useful symbol time 1/Δf.
    cyclic_suffix_ratio : float
        Cyclic suffix, overlapping the next prefix: it shortens the
        interference-free range and adds no time.
    coherent_phase : bool
        Give every echo its carrier phase exp(-j4π f_c R/c). False is the
        all-ones gain of the paper's simulation.
    noise : {"receiver", "transmitter"}
        Noise of every element of its own, or one noise that is sent with the
        signal and comes back with each echo, as in the paper's program.
    prs : Prs
        Positioning reference signal of the frame.

    Raises
    ------
    InputError
        If a number is out of range.

    References
    ----------
    arXiv 2310.06401, Table I.
    """

    carrier_hz: float = 70e9
    subcarrier_spacing_hz: float = 240e3
    n_subcarriers: int = 2048
    n_symbols: int = 224
    cyclic_prefix_ratio: float = 1 / 4
    cyclic_suffix_ratio: float = 1 / 32
    coherent_phase: bool = True
    noise: NoiseSource = "receiver"
    prs: Prs = Prs()

    def __post_init__(self) -> None:
        for name in ("n_subcarriers", "n_symbols"):
            require_count(name, getattr(self, name))
        for name in ("carrier_hz", "subcarrier_spacing_hz"):
            value = getattr(self, name)
            require(0 < value < np.inf, name, value, "a positive number of Hz")
        for name in ("cyclic_prefix_ratio", "cyclic_suffix_ratio"):
            value = getattr(self, name)
            require(0 <= value <= 1, name, value, "a number from 0 to 1")
        require(self.noise in get_args(NoiseSource), "noise", self.noise, "receiver and transmitter")

    @property
    def wavelength_m(self) -> float:
        """Carrier wavelength λ."""
        return SPEED_OF_LIGHT_MPS / self.carrier_hz

    @property
    def bandwidth_hz(self) -> float:
        """Occupied bandwidth B = N_c Δf."""
        return self.n_subcarriers * self.subcarrier_spacing_hz

    @property
    def symbol_time_s(self) -> float:
        """OFDM symbol time with its cyclic prefix."""
        return (1 + self.cyclic_prefix_ratio) / self.subcarrier_spacing_hz

    @property
    def range_bin_m(self) -> float:
        """Range bin c/2B."""
        return SPEED_OF_LIGHT_MPS / (2 * self.bandwidth_hz)

    @property
    def unambiguous_range_m(self) -> float:
        """Range c/2Δf after which echoes wrap."""
        return self.range_bin_m * self.n_subcarriers

    @property
    def isi_free_delay_s(self) -> float:
        """Delay up to which a path stays inside the undisturbed cyclic prefix, at least 0."""
        undisturbed_ratio = max(self.cyclic_prefix_ratio - self.cyclic_suffix_ratio, 0.0)
        return undisturbed_ratio / self.subcarrier_spacing_hz

    @property
    def isi_free_range_m(self) -> float:
        """Range up to which echoes stay inside the undisturbed cyclic prefix, at least 0."""
        return SPEED_OF_LIGHT_MPS * self.isi_free_delay_s / 2

    @property
    def velocity_bin_mps(self) -> float:
        """Velocity bin λ / (2 N_sym T_OFDM)."""
        return self.wavelength_m / (2 * self.n_symbols * self.symbol_time_s)

    @property
    def unambiguous_speed_mps(self) -> float:
        """Largest speed of either sign that does not alias."""
        return self.velocity_bin_mps * self.n_symbols / 2

    @property
    def processing_gain(self) -> float:
        """Power gain N_c N_sym of the range-Doppler map over one resource element."""
        return float(self.n_subcarriers * self.n_symbols)


def prs_elements(system: System) -> Mask:
    """Resource elements that carry the positioning reference signal.

    Returns
    -------
    ndarray of bool, shape (n_subcarriers, n_symbols)

    References
    ----------
    3GPP TS 38.211, 7.4.1.7.3, table 7.4.1.7.3-1.
    """
    prs = system.prs
    slot, symbol = np.divmod(np.arange(system.n_symbols), SLOT_SYMBOLS)
    number = symbol - prs.first_symbol
    offset = np.array(COMB_OFFSETS[prs.comb])[number % prs.comb]
    in_comb = np.arange(system.n_subcarriers)[:, None] % prs.comb == offset
    is_sent = (slot % prs.period == prs.offset) & (number >= 0) & (number < prs.n_symbols)
    return in_comb & is_sent


def resource_elements(system: System, sensing: Sensing) -> Mask:
    """Resource elements (n_subcarriers, n_symbols) that are sensed with.

    Of the PRS the slots that the frame holds whole, because what bursts of different length leave of an echo
    has no simple form; where it holds none, what there is of the first.
    """
    if sensing == "prs":
        mask = prs_elements(system)
        in_whole_slots = system.n_symbols // SLOT_SYMBOLS * SLOT_SYMBOLS
        if mask[:, :in_whole_slots].any():
            mask[:, in_whole_slots:] = False
        return mask
    if sensing == "all":
        return np.ones((system.n_subcarriers, system.n_symbols), dtype=np.bool_)
    raise unknown_name("sensing", sensing, get_args(Sensing))
