"""Bound of the frequency of one tone, the closed form behind all four parameters on the full grid."""

import numpy as np


def tone_std_bins(n, snr_post):
    """Standard deviation in bins of the DFT of n samples (Rife and Boorstyn, 1974)."""
    return np.sqrt(3 / (2 * np.pi**2 * snr_post * (1 - n**-2)))
