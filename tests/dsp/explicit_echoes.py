"""The signal model written out element by element, which bounds are held against."""

import numpy as np
import pytest
from scipy import constants

from isacbench.model.numerology import System, resource_elements

SHAPE = (3, 4)
SYSTEMS = {"all": System(n_subcarriers=7, n_symbols=5), "prs": System(n_subcarriers=14, n_symbols=70)}
"""The comb on 14 subcarriers is not symmetric about its middle, so that inner products are complex there."""

PAIR_SYSTEM, PAIR_SHAPE = System(n_subcarriers=32, n_symbols=70), (4, 6)
MIDDLE_PHASE = np.pi * np.array([-31 / 32, 69 / 70, -3 / 4, -5 / 6])
"""Phase of an echo at the middle of this grid and array, per Rayleigh cell in range, velocity, u and w."""

SENSING = pytest.mark.parametrize("sensing", ["all", "prs"])


def echoes_and_slopes(system, shape, sensing, places):
    """Echoes (elements, K) of amplitude 1 at places (4, K), and their slopes (elements, 4K)."""
    n, m = np.nonzero(resource_elements(system, sensing))
    p, q = (index.ravel() for index in np.indices(shape))
    along_range = -n * system.subcarrier_spacing_hz
    along_doppler = m * system.symbol_time_s * system.carrier_hz
    grid = 4 * np.pi / constants.speed_of_light * np.stack([along_range, along_doppler], axis=1)
    array = -np.pi * np.stack([p, q], axis=1)
    turns = np.concatenate([np.repeat(grid, p.size, axis=0), np.tile(array, (n.size, 1))], axis=1)
    echoes = np.exp(1j * turns @ places)
    return echoes, (1j * echoes[:, :, None] * turns[:, None]).reshape(len(turns), -1)


def normalised(difference, covariance):
    """Difference of joint covariances (K, 4, K, 4), in standard deviations of one of them."""
    std = standard_deviations(covariance)
    return difference / np.multiply.outer(std, std)


def standard_deviations(covariance):
    """Standard deviations (K, 4) of a joint covariance (K, 4, K, 4)."""
    return np.sqrt(np.einsum("kiki->ki", covariance))
