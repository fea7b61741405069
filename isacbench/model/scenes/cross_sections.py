"""Radar cross sections of 3GPP TR 38.901, and path loss, as amplitudes of echoes."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ndtri

from isacbench.checked_arrays import Floats
from isacbench.model.scenes.raw_uniforms import raw_uniforms

CROSS_SECTIONS = {
    "tr38901:uav_small": (-12.81, 3.74),
    "tr38901:uav_large": (-5.85, 2.50),
    "tr38901:human": (-1.37, 3.94),
    "tr38901:vehicle": (11.25, 3.41),
    "tr38901:agv": (-4.25, 2.51),
}
"""10 lg of the mean cross section σ_M in dBsm, and standard deviation of σ_S in dB.

3GPP TR 38.901 V19.4.0, Tables 7.9.2.1-1 to 7.9.2.1-7.
"""

DECIMALS = 6
"""Of a drawn cross section in dBsm: quantiles differ in the last digits between machines."""


def cross_section_dbsm(rcs_dbsm: float | str, key: str) -> float:
    """Radar cross section of an object: the given one, or one drawn by 3GPP TR 38.901.

    Parameters
    ----------
    rcs_dbsm : float or str
        Number, or a name of `CROSS_SECTIONS`.
    key : str
        Key of the draw, as `isacbench.model.scenes.raw_uniforms.raw_uniforms` takes it.

    Notes
    -----
    A drawn one is σ_M σ_S (§7.9.2.1). σ_S is log-normal, and eq. 7.9.2-1 gives
    10 lg σ_S the mean that makes the mean of σ_S 1. The part that depends on
    direction, σ_D, is left out: the visible points of an object already do.
    """
    if not isinstance(rcs_dbsm, str):
        return rcs_dbsm
    mean_dbsm, deviation_db = CROSS_SECTIONS[rcs_dbsm]
    normal = float(ndtri(raw_uniforms(key, 1)[0] + 2.0**-54))
    drawn_db = -math.log(10) / 20 * deviation_db**2 + deviation_db * normal
    return round(mean_dbsm + drawn_db, DECIMALS)


def free_space_amplitudes(range_m: Floats, wavelength_m: float) -> Floats:
    """Amplitudes of echoes from 1 m² by the radar equation, with isotropic antennas.

    Parameters
    ----------
    range_m : ndarray of float64, shape (n,)
        Positive.

    Returns
    -------
    ndarray of float64, shape (n,)
        Root of received over transmitted power, λ / ((4π)^1.5 R²).

    References
    ----------
    M. A. Richards, Fundamentals of Radar Signal Processing, 2nd ed., eq. 2.8.
    """
    return wavelength_m / ((4 * np.pi) ** 1.5 * range_m**2)
