"""The virtual array: the sum co-array of transmit and receive elements, and the sign of their phases.

An element that lies d further along +u is nearer to an echo from there by d u:
its path is shorter, and with exp(-j2πfτ), the sign of range and Doppler, its
phase is ahead by +2π d u / λ. The paper and this package write
exp(-jπ(p u + q w)) for the element (p, q). So their elements ascend towards -u
and -w. `VirtualArray.ascending` says so of recorded frames that count otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike

from isacbench.checked_arrays import Complex, Integers, Mask, checked_array
from isacbench.choices import Mimo
from isacbench.errors import InputError, require
from isacbench.model.number_limits import require_count
from isacbench.model.scenes.raw_uniforms import raw_uniforms

PAPER_ORDER = ("-u", "-w")
"""Directions towards which elements ascend whose phases are exp(-jπ(p u + q w))."""


MOST_LEAKAGE_DB = 200.0
"""Largest power, of either sign, of the direct path over that of all echoes."""


def rectangular_positions(shape: tuple[int, int], spacing: int) -> Integers:
    """Element positions (n, 2) of a rectangular array, `spacing` apart."""
    p, q = np.meshgrid(np.arange(shape[0]), np.arange(shape[1]), indexing="ij")
    return spacing * np.stack([p.ravel(), q.ravel()], axis=1)


@dataclass(frozen=True)
class VirtualArray:
    """Transmit and receive arrays and the virtual array they span.

    Attributes
    ----------
    tx_shape, rx_shape : (int, int)
        Elements along u and w.
    tx_spacing, rx_spacing : int
        Element distance in units of the frame's `spacing_wavelengths`, half a wavelength by default.
    ascending : (str, str)
        Directions towards which the elements of a frame ascend, as seen from
        its element (0, 0): "-u" or "+u", and "-w" or "+w". Frames are written
        and read in this order; observations always ascend towards -u and -w.
    mimo : {"ideal", "comb", "tdm"}
        How the transmitters are separated. "ideal": every one has all resource
        elements to itself. "comb" and "tdm": they take turns on successive
        subcarriers, and on successive symbols.
    leakage_db : float or None
        Power of the direct path from the transmitters to a receiver, over that
        of all echoes, in dB; None for no leakage.

    Raises
    ------
    InputError
        If a number is not positive and whole, the sum co-array is not a
        filled rectangle, or a direction is unknown.

    References
    ----------
    Hoctor and Kassam, "The unifying role of the coarray in aperture synthesis
    for coherent and incoherent imaging", Proc. IEEE 78 (1990).
    """

    tx_shape: tuple[int, int] = (2, 2)
    rx_shape: tuple[int, int] = (8, 8)
    tx_spacing: int = 8
    rx_spacing: int = 1
    ascending: tuple[str, str] = PAPER_ORDER
    mimo: Mimo = "ideal"
    leakage_db: float | None = None

    def __post_init__(self) -> None:
        for name in ("tx_shape", "rx_shape"):
            for count in getattr(self, name):
                require_count(f"array.{name}", count)
        for name in ("tx_spacing", "rx_spacing"):
            require_count(f"array.{name}", getattr(self, name))
        known = [(u, w) for u in ("-u", "+u") for w in ("-w", "+w")]
        require(self.ascending in known, "array.ascending", self.ascending, "-u or +u, and -w or +w")
        require(self.mimo in get_args(Mimo), "array.mimo", self.mimo, "ideal, comb and tdm")
        if self.leakage_db is not None:
            limits = f"numbers from -{MOST_LEAKAGE_DB:g} to {MOST_LEAKAGE_DB:g}"
            require(abs(self.leakage_db) <= MOST_LEAKAGE_DB, "array.leakage_db", self.leakage_db, limits)
        n_p, n_q = self.shape
        if len(self.positions) != n_p * n_q:
            raise InputError(
                f"array: the sum co-array of tx_shape {self.tx_shape} at tx_spacing {self.tx_spacing} and "
                f"rx_shape {self.rx_shape} at rx_spacing {self.rx_spacing} fills "
                f"{len(self.positions)} of {n_p} x {n_q} places; it must be a filled rectangle"
            )

    @property
    def positions(self) -> Integers:
        """Distinct virtual element positions (n, 2) in element spacings, row by row."""
        return self._elements[0]

    @property
    def transmitters(self) -> Integers:
        """Transmitter of every virtual element (n,), the first of those that give it with some receiver."""
        return self._elements[1] // (self.rx_shape[0] * self.rx_shape[1])

    @cached_property
    def _elements(self) -> tuple[Integers, Integers]:
        """Distinct sums of a transmitter's and a receiver's position, and the first pair that gives each."""
        tx = rectangular_positions(self.tx_shape, self.tx_spacing)
        rx = rectangular_positions(self.rx_shape, self.rx_spacing)
        pairs = (tx[:, None, :] + rx[None, :, :]).reshape(-1, 2)
        positions, first_pair = np.unique(pairs, axis=0, return_index=True)
        positions.setflags(write=False)
        return positions, first_pair

    @property
    def thinning(self) -> tuple[int, int]:
        """Subcarriers, and symbols, of which a transmitter has one: 1 unless transmitters take turns."""
        n_tx = self.tx_shape[0] * self.tx_shape[1]
        return (n_tx if self.mimo == "comb" else 1, n_tx if self.mimo == "tdm" else 1)

    @property
    def n_turns(self) -> int:
        """Resource elements of which a virtual element has one."""
        return self.thinning[0] * self.thinning[1]

    @property
    def shares(self) -> list[tuple[slice, slice, Mask]]:
        """Subcarriers and symbols of transmitters that take turns, and masks of their virtual elements."""
        (every_n, every_m), of = self.thinning, self.transmitters % self.n_turns
        return [
            (slice(t % every_n, None, every_n), slice(t % every_m, None, every_m), of == t)
            for t in range(self.n_turns)
        ]

    @property
    def shape(self) -> tuple[int, int]:
        """Virtual elements (P, Q) along u and w."""
        n_p, n_q = self.positions.max(axis=0) + 1
        return int(n_p), int(n_q)

    def in_frame(self, elements: ArrayLike) -> Integers:
        """Indices in the last two axes of a frame of elements at places (e, 2) in the virtual array."""
        places, (n_p, n_q) = checked_array("elements", elements, np.int64), self.shape
        is_mirrored = [axis.startswith("+") for axis in self.ascending]
        return np.where(is_mirrored, (n_p - 1, n_q - 1) - places, places)


def element_errors(name: str, gain_error_db: float, phase_error_deg: float, elements: ArrayLike) -> Complex:
    """Draw complex factors (e,) of virtual elements (e, 2) that are not calibrated.

    The gain in dB and the phase of an element are normal, of mean 0. They follow from the scenario's name and
    the element's place alone, and scale with the standard deviations. They are the same on every machine, and
    exactly 1 where both standard deviations are 0.
    """
    places = checked_array("elements", elements, np.int64).reshape(-1, 2)
    if not (gain_error_db or phase_error_deg):
        return np.ones(len(places), dtype=np.complex128)
    uniforms = np.array([raw_uniforms(f"element {p} {q} of {name}", 2) for p, q in places.tolist()])
    # Box and Muller (1958); rounded, because logarithms and sines differ in the last digits.
    radius, angle = np.sqrt(-2 * np.log1p(-uniforms[:, 0])), 2 * np.pi * uniforms[:, 1]
    gain_db = gain_error_db * (radius * np.cos(angle)).round(9)
    phase_rad = np.radians(phase_error_deg) * (radius * np.sin(angle)).round(9)
    return 10 ** (gain_db / 20) * np.exp(1j * phase_rad)
