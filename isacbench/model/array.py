"""The virtual array: the sum co-array of transmit and receive elements."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from isacbench.errors import InputError
from isacbench.model.number_limits import require_count
from isacbench.model.scenes.raw_uniforms import raw_uniforms

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


def rectangular_positions(shape: tuple[int, int], spacing: int) -> NDArray[np.int64]:
    """Element positions of a rectangular array in half wavelengths.

    Parameters
    ----------
    shape : (int, int)
        Elements along u and along w.
    spacing : int
        Distance of neighbours in half wavelengths.

    Returns
    -------
    ndarray of int64, shape (shape[0] * shape[1], 2)

    Examples
    --------
    >>> rectangular_positions((2, 1), 8).tolist()
    [[0, 0], [8, 0]]
    """
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
        Element distance in half wavelengths.

    Raises
    ------
    InputError
        If a number is not positive and whole, or the sum co-array is not a
        filled rectangle.

    References
    ----------
    Hoctor and Kassam, "The unifying role of the coarray in aperture synthesis
    for coherent and incoherent imaging", Proc. IEEE 78 (1990).

    Examples
    --------
    >>> VirtualArray().shape
    (16, 16)
    """

    tx_shape: tuple[int, int] = (2, 2)
    rx_shape: tuple[int, int] = (8, 8)
    tx_spacing: int = 8
    rx_spacing: int = 1

    def __post_init__(self) -> None:
        for name in ("tx_shape", "rx_shape"):
            for count in getattr(self, name):
                require_count(f"array.{name}", count)
        for name in ("tx_spacing", "rx_spacing"):
            require_count(f"array.{name}", getattr(self, name))
        n_p, n_q = self.shape
        if len(self.positions) != n_p * n_q:
            raise InputError(
                f"array: the sum co-array of tx_shape {self.tx_shape} at tx_spacing {self.tx_spacing} and "
                f"rx_shape {self.rx_shape} at rx_spacing {self.rx_spacing} half wavelengths fills "
                f"{len(self.positions)} of {n_p} x {n_q} places; it must be a filled rectangle"
            )

    @cached_property
    def positions(self) -> NDArray[np.int64]:
        """Distinct virtual element positions (n, 2) in half wavelengths, row by row."""
        tx = rectangular_positions(self.tx_shape, self.tx_spacing)
        rx = rectangular_positions(self.rx_shape, self.rx_spacing)
        positions = np.unique((tx[:, None, :] + rx[None, :, :]).reshape(-1, 2), axis=0)
        positions.setflags(write=False)
        return positions

    @property
    def shape(self) -> tuple[int, int]:
        """Virtual elements (P, Q) along u and w."""
        n_p, n_q = self.positions.max(axis=0) + 1
        return int(n_p), int(n_q)


def element_errors(
    name: str, gain_error_db: float, phase_error_deg: float, elements: ArrayLike
) -> NDArray[np.complex128]:
    """Draw complex factors of virtual elements that are not calibrated.

    The gain in dB and the phase of an element are normal, of mean 0. They
    follow from the scenario's name and the element's place alone, and scale
    with the standard deviations. They are the same on every machine.

    Parameters
    ----------
    name : str
        Name of the scenario.
    gain_error_db, phase_error_deg : float
        Standard deviations.
    elements : array_like of int, shape (e, 2)
        Places (p, q) in the virtual array.

    Returns
    -------
    ndarray of complex128, shape (e,)
        Exactly 1 where both standard deviations are 0.

    Examples
    --------
    >>> element_errors("street", 0.0, 0.0, [[0, 0], [3, 1]]).tolist()
    [(1+0j), (1+0j)]
    """
    places = np.asarray(elements, dtype=np.int64).reshape(-1, 2)
    if not (gain_error_db or phase_error_deg):
        return np.ones(len(places), dtype=np.complex128)
    uniforms = np.array([raw_uniforms(f"element {p} {q} of {name}", 2) for p, q in places.tolist()])
    # Box and Muller (1958); rounded, because logarithms and sines differ in the last digits.
    radius, angle = np.sqrt(-2 * np.log1p(-uniforms[:, 0])), 2 * np.pi * uniforms[:, 1]
    gain_db = gain_error_db * (radius * np.cos(angle)).round(9)
    phase_rad = np.radians(phase_error_deg) * (radius * np.sin(angle)).round(9)
    factors: NDArray[np.complex128] = 10 ** (gain_db / 20) * np.exp(1j * phase_rad)
    return factors
