"""Figures of a range-Doppler map, its threshold, and what exceeds it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from isacbench.report.drawing.style import THRESHOLD, edges, entitle, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from isacbench.model.numerology import System
    from isacbench.plugins.contracts import Diagnosis

    Floats = NDArray[np.floating]

POWER = "power over noise [dB]"

LOWEST_RATIO = 0.01
"""Power over noise below which nothing is told apart: one look at noise can be arbitrarily weak."""


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
    figure = new_figure(12.0, 4.3)
    margins = edges(figure, left=0.6, right=0.15, bottom=0.5, top=0.75)
    grid = figure.add_gridspec(1, 5, width_ratios=(1, 1, 1, 0.5, 1.9), wspace=0.12, **margins)
    limits = float(min(power_db.min(), threshold_db.min())), float(power_db.max())
    extent = (*outer(velocity_mps), *outer(range_m))
    maps = {
        "power": power_db,
        "threshold": threshold_db,
        "power where detected": np.where(diagnosis.detection.mask, power_db, np.nan),
    }
    panels = [figure.add_subplot(grid[0, index]) for index in range(len(maps))]
    for axes, (name, values) in zip(panels, maps.items(), strict=True):
        image = axes.imshow(
            values, origin="lower", aspect="auto", interpolation="nearest", extent=extent, clim=limits
        )
        axes.set_facecolor("0.93")
        axes.set_title(name)
        axes.set_xlabel("radial velocity [m/s]")
        axes.label_outer()
    panels[0].set_ylabel("range [m]")
    left, _, width, height = panels[-1].get_position().bounds
    bar = figure.add_axes((left + width + 0.008, panels[-1].get_position().y0, 0.01, height))
    figure.colorbar(image, cax=bar, label=POWER)
    strongest = int(np.unravel_index(np.argmax(power_db), power_db.shape)[0])
    cut = figure.add_subplot(grid[0, 4])
    _draw_cut(
        cut, velocity_mps, power_db[strongest], threshold_db[strongest], diagnosis.detection.mask[strongest]
    )
    cut.set_title(f"cut at the strongest range, {range_m[strongest]:.1f} m")
    panels[0].axhline(range_m[strongest], color="w", linewidth=0.8, linestyle=":")
    entitle(figure, title)
    return figure


def _decibels(ratio: Floats) -> Floats:
    """Power ratios in dB."""
    decibels: Floats = 10 * np.log10(np.maximum(ratio, LOWEST_RATIO))
    return decibels


def outer(centres: Floats) -> tuple[float, float]:
    """Outer borders of evenly spaced cells."""
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
    axes.set_xlabel("radial velocity [m/s]")
    axes.set_ylabel(POWER)
    axes.grid(True)
    axes.legend(loc="upper right")
