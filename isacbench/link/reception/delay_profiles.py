"""Tapped-delay profiles of 3GPP: delays and powers of the taps of a channel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

import pandas as pd

from isacbench.errors import unknown_name

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

ProfileName = Literal["tdl_a", "tdl_b", "tdl_c", "tdl_d", "tdl_e"]

WITH_LINE_OF_SIGHT: tuple[ProfileName, ...] = ("tdl_d", "tdl_e")


@dataclass(frozen=True, eq=False)
class Profile:
    """Taps of a channel.

    Attributes
    ----------
    delay : ndarray of float64, shape (n_taps,)
        In units of the rms delay spread, the first tap at 0.
    power : ndarray of float64, shape (n_taps,)
        Mean powers, together 1.
    has_line_of_sight : bool
        True if the first tap is a constant ray. All other taps are Rayleigh
        fading.
    """

    delay: NDArray[np.float64]
    power: NDArray[np.float64]
    has_line_of_sight: bool


def delay_profile(name: ProfileName) -> Profile:
    """Look up the taps of a profile.

    Parameters
    ----------
    name : {"tdl_a", "tdl_b", "tdl_c", "tdl_d", "tdl_e"}
        The last two have a line of sight.

    Returns
    -------
    Profile

    Raises
    ------
    InputError
        If there is no such profile.

    References
    ----------
    3GPP TR 38.901, tables 7.7.2-1 to 7.7.2-5.

    Examples
    --------
    >>> delay_profile("tdl_a").delay.size
    23
    """
    if name not in get_args(ProfileName):
        raise unknown_name("profile", name, get_args(ProfileName))
    taps = _taps().loc[[name]]
    power = 10 ** (taps["power_db"].to_numpy() / 10)
    return Profile(taps["delay"].to_numpy(), power / power.sum(), name in WITH_LINE_OF_SIGHT)


@cache
def _taps() -> pd.DataFrame:
    """Delay and power of the taps of all profiles, indexed by the profile.

    A line of sight is a tap of its own, at the delay of the Rayleigh tap behind it.
    """
    return pd.read_csv(Path(__file__).with_suffix(".csv"), index_col="profile")
