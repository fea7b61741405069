"""Zero-Doppler notch: static echoes are taken out of a map before anything is detected in it.

In each range cell and element the static echo is fitted to the bins next to zero Doppler and subtracted.
Noise as strong as that of the map takes its place: detectors need not know of the notch. The fit is to
tapered bins, as detection is, so that echoes beyond the mainlobe of the taper hardly change it. Points that
move no faster than the notch, or than a velocity bin, are left out of the image: the map has lost what it
showed there.
"""

from __future__ import annotations

import numpy as np

from isacbench.dsp.cell_detection import white_noise
from isacbench.dsp.rangedoppler import GatedMap
from isacbench.dsp.windows import Window, reach, taper
from isacbench.errors import require
from isacbench.model.cloud import PointCloud
from isacbench.model.numerology import System

LEAST_SHOWN = 1e-6
"""Amplitude of a static echo in a map below which there is nothing to take out."""


def check_notch(notch_mps: float | None) -> None:
    """Refuse what is no speed."""
    require(
        notch_mps is None or 0 <= notch_mps < np.inf, "notch_mps", notch_mps, "a speed from 0 on, or none"
    )


def without_static_echoes(gated: GatedMap, system: System, window: Window) -> GatedMap:
    """Replace static echoes by noise, which is drawn from a fixed seed.

    `window` is the taper along Doppler with which cells are detected. The map itself is returned if its
    Doppler bins do not show static echoes.
    """
    rows = np.moveaxis(gated.cells, 1, 0)
    echo = gated.doppler_kernel(system.n_symbols).response(gated.gate.doppler_bins, [0.0])[:, 0]
    echo /= np.sqrt(system.n_symbols)
    tapered = taper(echo, window, axis=0)
    energy = np.vdot(tapered, tapered).real
    if energy < LEAST_SHOWN**2:
        return gated
    # Least squares on tapered bins, as weights of the bins themselves.
    weights = taper(np.pad(tapered, 2 * reach(window)), window, axis=0) / energy
    amplitude = np.tensordot(weights.conj(), rows, axes=1)
    real, imag = np.random.default_rng(0).standard_normal((2, *amplitude.shape))
    amplitude -= np.sqrt(white_noise(gated) / 2) * np.linalg.norm(weights) * (real + 1j * imag)
    notched = rows - np.multiply.outer(echo, amplitude)
    return GatedMap(np.moveaxis(notched, 0, 1), gated.gate, gated.elements, gated.bursts)


def without_slow_points(cloud: PointCloud, system: System, notch_mps: float) -> PointCloud:
    """Drop the points that are no faster than the notch, or than a velocity bin."""
    return cloud.select(np.abs(cloud.velocity) > max(notch_mps, system.velocity_bin_mps))
