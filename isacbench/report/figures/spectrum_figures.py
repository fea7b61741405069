"""Angular spectra of one range-Doppler cell."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.lines import Line2D

from isacbench.files.escaping import counted
from isacbench.report.drawing.style import THRESHOLD, TRUE, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from isacbench.model.scene import Scenario
    from isacbench.plugins.contracts import Diagnosis, Spectrum

LEVEL, PEAK = "0.25", "#0072B2"
LEGEND = (
    Line2D([], [], color=LEVEL, label="spectrum"),
    Line2D([], [], color=THRESHOLD, linestyle="--", label="threshold"),
    Line2D([], [], color=PEAK, marker="v", linestyle="", markersize=6, label="peak taken for an echo"),
    Line2D([], [], color=TRUE, marker="|", linestyle="", markersize=10, label="true scatterer of the cell"),
)
HALF_BIN = 0.5


def draw_spectra(title: str, diagnosis: Diagnosis, scenario: Scenario) -> Figure:
    """Draw the spectra of a cell with threshold and peaks, and the true directions of what lies in it.

    Parameters
    ----------
    title : str
        Title, which the cell is added to.
    diagnosis : Diagnosis
        With a cell and at least one spectrum.
    scenario : Scenario
        Its scatterers are marked.

    Returns
    -------
    Figure
    """
    if diagnosis.cell is None:
        raise ValueError("a figure of spectra takes a diagnosis with a cell")
    range_bin, doppler_bin = diagnosis.cell
    true = _true_cosines(scenario, range_bin, doppler_bin)
    range_m = range_bin * scenario.system.range_bin_m
    velocity_mps = doppler_bin * scenario.system.velocity_bin_mps
    cell = f"strongest cell: {range_m:.1f} m, {velocity_mps:.1f} m/s, {counted(true['u'].size, 'scatterer')}"
    if diagnosis.separated is False:
        cell += ", signal and noise subspaces not separated"
    n_spectra = len(diagnosis.spectra)
    figure = new_figure(5.2 * n_spectra, 3.4, legend=LEGEND, title=f"{title}; {cell}")
    panels = figure.subplots(1, n_spectra, squeeze=False).flat
    for axes, spectrum in zip(panels, diagnosis.spectra, strict=True):
        _draw_spectrum(axes, spectrum, true[spectrum.label])
    return figure


def _true_cosines(scenario: Scenario, range_bin: int, doppler_bin: int) -> dict[str, NDArray[np.float64]]:
    """Compute the direction cosines of the scatterers within half a bin of a cell, by name."""
    offset_m = scenario.scatterers.xyz - scenario.base_station_m
    range_bins = np.linalg.norm(offset_m, axis=1) / scenario.system.range_bin_m
    doppler_bins = scenario.scatterers.velocity / scenario.system.velocity_bin_mps
    inside = (np.abs(range_bins - range_bin) <= HALF_BIN) & (np.abs(doppler_bins - doppler_bin) <= HALF_BIN)
    u, w = scenario.frame.direction_cosines(offset_m[inside])
    return {"u": u, "w": w}


def _draw_spectrum(axes: Axes, spectrum: Spectrum, true: NDArray[np.float64]) -> None:
    """Draw one spectrum."""
    axes.plot(spectrum.cosine, spectrum.level_db, color=LEVEL)
    if spectrum.threshold_db is not None:
        threshold_db = np.broadcast_to(spectrum.threshold_db, spectrum.cosine.shape)
        axes.plot(spectrum.cosine, threshold_db, color=THRESHOLD, linestyle="--")
    levels_db = np.interp(spectrum.peaks, spectrum.cosine, spectrum.level_db)
    axes.plot(spectrum.peaks, levels_db, "v", color=PEAK, markersize=7)
    axes.plot(
        true, np.full(true.size, 0.03), "|", color=TRUE, markersize=12, transform=axes.get_xaxis_transform()
    )
    axes.margins(x=0, y=0.12)
    axes.set(xlabel=f"direction cosine {spectrum.label}", ylabel="spectrum level [dB]")
    axes.grid(True)
