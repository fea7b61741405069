"""Transmitted signal, and the way in which it is sensed with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import get_args

from isacbench.choices import Division, Modulation, Sensing
from isacbench.errors import require, unknown_name
from isacbench.link.waveform.qam import bits_per_symbol

LARGEST_N_ID = 4095
"""Largest identity of a PRS sequence (3GPP TS 38.211, 7.4.1.7.2)."""


@dataclass(frozen=True)
class Signal:
    """Transmitted signal, and how its echo is divided by it.

    Attributes
    ----------
    modulation : {"qpsk", "16qam", "64qam", "256qam"}
        Of the data; the PRS is QPSK always.
    sensing : {"all", "prs"}
        Resource elements that are sensed with: the whole grid, or the PRS alone.
    division : {"reciprocal", "matched", "wiener"}
        Of received Y by sent X: Y/X, which strengthens the noise of weak
        symbols; Y X*, whose echo has the power of the symbols on it; and
        Y X*/(|X|² + 1/SNR), which is between them and takes the SNR of the
        echo as known. All three are the same where |X| = 1.
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
        if self.sensing not in get_args(Sensing):
            raise unknown_name("sensing", self.sensing, get_args(Sensing))
        if self.division not in get_args(Division):
            raise unknown_name("division", self.division, get_args(Division))
        require_n_id(self.n_id)

    @property
    def has_unit_modulus(self) -> bool:
        """True where all symbols that are sensed with have the same power."""
        return self.sensing == "prs" or self.modulation == "qpsk"

    @property
    def is_plain(self) -> bool:
        """True where division leaves echo and noise as in the closed form: all elements, equal powers."""
        return self.sensing == "all" and self.has_unit_modulus


def require_n_id(n_id: object) -> None:
    """Refuse what is no identity of a PRS sequence.

    Parameters
    ----------
    n_id : object

    Raises
    ------
    InputError
        If it is not a whole number from 0 to 4095.
    """
    allowed = type(n_id) is int and 0 <= n_id <= LARGEST_N_ID
    require(allowed, "n_id", n_id, f"a whole number from 0 to {LARGEST_N_ID}")
