"""Figures of a range-Doppler map, its threshold, and what exceeds it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from isacbench.report.drawing.style import THRESHOLD, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from isacbench.model.numerology import System
    from isacbench.plugins.contracts import Diagnosis

    Floats = NDArray[np.floating]

POWER = "power over noise [dB]"

LOWEST_RATIO = 0.01
"""Lowest drawn ratio of power to noise: one look at noise can be arbitrarily weak."""


def draw_map(title: str, diagnosis: Diagnosis, system: System, noise_power: float) -> Figure:
    """Draw a range-Doppler map, its threshold, the detected cells, and a cut through the strongest.

    Parameters
    ----------
    title : str
    diagnosis : Diagnosis
    system : System
        Turns bins into metres and metres a second.
    noise_power : float
        Power that counts as 0 dB.

    Returns
    -------
    Figure
    """
    power_db = _decibels(diagnosis.power / noise_power)
    threshold_db = _decibels(diagnosis.detection.threshold / noise_power)
    range_m = diagnosis.range_bins * system.range_bin_m
    velocity_mps = diagnosis.doppler_bins * system.velocity_bin_mps
    figure = new_figure(12.0, 4.3, title=title)
    *panels, cut = figure.subplots(1, 4, width_ratios=(1, 1, 1, 1.9))
    limits = float(min(power_db.min(), threshold_db.min())), float(power_db.max())
    extent = (*outer(velocity_mps), *outer(range_m))
    maps = {
        "power": power_db,
        "threshold": threshold_db,
        "power where detected": np.where(diagnosis.detection.mask, power_db, np.nan),
    }
    for axes, (name, values) in zip(panels, maps.items(), strict=True):
        image = axes.imshow(
            values, origin="lower", aspect="auto", interpolation="nearest", extent=extent, clim=limits
        )
        axes.set_facecolor("0.93")
        axes.set(title=name, xlabel="radial velocity [m/s]")
        axes.label_outer()
    panels[0].set_ylabel("range [m]")
    figure.colorbar(image, ax=panels, label=POWER, aspect=30)
    row = int(np.unravel_index(np.argmax(power_db), power_db.shape)[0])
    _draw_cut(cut, velocity_mps, power_db[row], threshold_db[row], diagnosis.detection.mask[row])
    cut.set_title(f"cut at the strongest range, {range_m[row]:.1f} m")
    panels[0].axhline(range_m[row], color="w", linewidth=0.8, linestyle=":")
    return figure


def _decibels(ratio: Floats) -> Floats:
    """Convert power ratios to dB."""
    decibels: Floats = 10 * np.log10(np.maximum(ratio, LOWEST_RATIO))
    return decibels


def outer(centres: Floats) -> tuple[float, float]:
    """Compute the outer borders of evenly spaced cells.

    Parameters
    ----------
    centres : ndarray of float, shape (n,)
        In ascending order.

    Returns
    -------
    first, last : float
        In the unit of the centres.
    """
    half = (centres[-1] - centres[0]) / max(2 * (centres.size - 1), 1) or 0.5
    return float(centres[0] - half), float(centres[-1] + half)


def _draw_cut(
    axes: Axes,
    velocity_mps: Floats,
    power_db: Floats,
    threshold_db: Floats,
    mask: NDArray[np.bool_],
) -> None:
    """Draw power and threshold along Doppler."""
    axes.plot(velocity_mps, power_db, color="0.35", marker="o", markersize=3, label="power")
    axes.plot(velocity_mps[mask], power_db[mask], "o", color="#0072B2", markersize=5.5, label="detected")
    axes.plot(velocity_mps, threshold_db, color=THRESHOLD, linestyle="--", label="threshold")
    axes.set(xlabel="radial velocity [m/s]", ylabel=POWER)
    axes.grid(True)
    axes.legend(loc="upper right")
