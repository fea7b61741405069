"""The positioning reference signal: which resource elements are known to every receiver.

PRS of comb size 4 on the 2nd to the 13th symbol of every fourth slot. Symbols of a slot
take turns in the comb, so that four of them touch every subcarrier.
"""

from __future__ import annotations

from typing import get_args

import numpy as np

from isacbench.checked_arrays import Mask
from isacbench.choices import Sensing
from isacbench.errors import unknown_name
from isacbench.model.numerology import System

COMB_SIZE = 4
COMB_OFFSETS = (0, 2, 1, 3)
"""First subcarrier on successive PRS symbols, counted from the first of a slot."""

SLOT_SYMBOLS = 14
FIRST_SYMBOL, LAST_SYMBOL = 1, 12
"""PRS symbols of a slot, counted from 0."""

SLOT_PERIOD = 4


def prs_elements(system: System) -> Mask:
    """Resource elements that carry the positioning reference signal.

    Returns
    -------
    ndarray of bool, shape (n_subcarriers, n_symbols)

    References
    ----------
    3GPP TS 38.211, 7.4.1.7.3, table 7.4.1.7.3-1 (comb size 4, 12 symbols).
    """
    slot, symbol = np.divmod(np.arange(system.n_symbols), SLOT_SYMBOLS)
    offset = np.array(COMB_OFFSETS)[(symbol - FIRST_SYMBOL) % len(COMB_OFFSETS)]
    in_comb = np.arange(system.n_subcarriers)[:, None] % COMB_SIZE == offset
    is_sent = (slot % SLOT_PERIOD == 0) & (symbol >= FIRST_SYMBOL) & (symbol <= LAST_SYMBOL)
    return in_comb & is_sent


def resource_elements(system: System, sensing: Sensing) -> Mask:
    """Resource elements that are sensed with.

    Parameters
    ----------
    sensing : {"all", "prs"}

    Returns
    -------
    ndarray of bool, shape (n_subcarriers, n_symbols)
        Of the PRS the slots that the frame holds whole, because what bursts of
        different length leave of an echo has no simple form; where it holds
        none, what there is of the first.

    Raises
    ------
    InputError
        If `sensing` is neither.
    """
    if sensing == "prs":
        mask = prs_elements(system)
        n_whole = system.n_symbols // SLOT_SYMBOLS
        if n_whole:
            mask[:, n_whole * SLOT_SYMBOLS :] = False
        return mask
    if sensing == "all":
        return np.ones((system.n_subcarriers, system.n_symbols), dtype=np.bool_)
    raise unknown_name("sensing", sensing, get_args(Sensing))
