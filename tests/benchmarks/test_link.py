"""The waveform of a frame against its bare transforms: ratios are printed and kept, times are not tested."""

import numpy as np
import pytest
from scipy.fft import fft, ifft

from isacbench.link.waveform.ofdm import demodulate, modulate
from isacbench.link.waveform.resource_grid import draw_grid
from isacbench.model.numerology import System


@pytest.fixture(scope="module")
def symbols():
    """Return the grid of a frame, 2048 subcarriers by 16 slots of 14 symbols."""
    return draw_grid(System()).symbols


def bare_transforms(symbols):
    return fft(ifft(symbols, axis=0, norm="ortho"), axis=0, norm="ortho")


def test_modulating_and_demodulating_against_bare_transforms(against, symbols):
    system = System()
    returned = against(
        lambda: demodulate(modulate(symbols, system), system),
        {"ifft and fft alone": lambda: bare_transforms(symbols)},
        rounds=30,
    )
    np.testing.assert_allclose(returned, symbols, rtol=0, atol=1e-12)
