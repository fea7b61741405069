"""Figures of a waveform: its spectrum, the peaks of its symbols, and the grid that it carries."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from isacbench.files.checked_files import make_own_folder
from isacbench.link.waveform.figures_of_merit import papr_ccdf, without_suffix
from isacbench.link.waveform.ofdm import modulate
from isacbench.link.waveform.power_spectrum import mean_power, measured_density, out_of_band_db, power_density
from isacbench.model.prs import SLOT_SYMBOLS
from isacbench.report.drawing.panels import panel_grid
from isacbench.report.drawing.style import (
    BOUND_COLOUR,
    COLOURS,
    LINES,
    drawable,
    new_figure,
    save,
    styled,
)

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from isacbench.choices import Modulation
    from isacbench.link.waveform.resource_grid import ResourceGrid
    from isacbench.model.numerology import System

    Floats = NDArray[np.float64]
    Waveform = NDArray[np.complex128]

OVERSAMPLING = 4
WIDE_POINTS, NARROW_POINTS = 401, 641
EDGE_SPACINGS = 10
"""Subcarrier spacings to either side of the edge of the band that are drawn large."""

WIDE_PANEL_IN = 4.6, 3.0
SHOWN_SUBCARRIERS = 16
PRS_COLOUR, DATA_COLOUR = COLOURS[1], "0.9"


def draw_waveform(
    folder: Path,
    name: str,
    system: System,
    grid: ResourceGrid,
    papr_db: Mapping[Modulation, Floats],
) -> list[Path]:
    """Draw all figures of a waveform.

    Parameters
    ----------
    folder : Path
        Figures of the same names in it are replaced.
    name : str
        Name of the scenario.
    system : System
    grid : ResourceGrid
        Content of the waveform.
    papr_db : mapping of str to ndarray
        Peak-to-average power ratios of drawn symbols, by modulation.

    Returns
    -------
    list of Path
        ``spectrum.png``, ``papr.png`` and ``grid.png``.

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    make_own_folder(folder)
    name = drawable(name)
    with styled():
        figures = {
            "spectrum": draw_spectrum(name, system, grid),
            "papr": draw_papr(name, system, papr_db),
            "grid": draw_resource_grid(name, grid),
        }
        return [save(figure, folder / f"{stem}.png") for stem, figure in figures.items()]


def draw_spectrum(name: str, system: System, grid: ResourceGrid) -> Figure:
    """Draw the spectrum as measured over the closed form, with and without the suffix.

    Parameters
    ----------
    name : str
    system : System
    grid : ResourceGrid

    Returns
    -------
    Figure
        The whole spectrum, averaged over a subcarrier spacing, and its upper
        edge. Sampling at four times the critical rate folds power from beyond:
        without suffix, the measured curve exceeds the closed form far from the band.
    """
    shapes = {"without suffix": (without_suffix(system), COLOURS[1])}
    if system.cyclic_suffix_ratio:
        shapes["with suffix"] = system, COLOURS[0]
    legend = []
    for label, (_, colour) in shapes.items():
        legend.append(Line2D([], [], color=colour, alpha=0.45, label=f"{label}, measured of one frame"))
        legend.append(Line2D([], [], color=colour, linestyle="--", label=f"{label}, closed form"))
    title = f"{name}: power density over its mean inside the band"
    figure, (whole, edge) = panel_grid(2, legend, title, panel_in=WIDE_PANEL_IN)
    lowest_db = []
    for shaped, colour in shapes.values():
        waveform = modulate(grid.symbols, shaped, OVERSAMPLING)
        lowest_db.append(_draw_whole(whole, shaped, colour, waveform))
        _draw_edge(edge, shaped, colour, waveform)
    for axes in (whole, edge):
        axes.set_ylabel("power density [dB]")
        axes.grid(True)
        axes.margins(x=0)
    whole.set(title="averaged over a subcarrier spacing", xlabel="frequency from subcarrier 0 [MHz]")
    whole.set_ylim(min(lowest_db) - 5, 8)
    edge.set(title="upper edge of the band", xlabel="subcarrier spacings beyond the edge", ylim=(-35, 5))
    return figure


def draw_papr(name: str, system: System, papr_db: Mapping[Modulation, Floats]) -> Figure:
    """Draw the share of the symbols with higher peaks, of every modulation and in theory.

    Parameters
    ----------
    name : str
    system : System
    papr_db : mapping of str to ndarray

    Returns
    -------
    Figure
    """
    n_symbols = len(next(iter(papr_db.values())))
    theories = [
        Line2D([], [], color=BOUND_COLOUR, linestyle="--", label="Gaussian envelope, crossings"),
        Line2D([], [], color=BOUND_COLOUR, linestyle=":", label="Gaussian samples at the critical rate"),
    ]
    lines = [
        Line2D([], [], color=COLOURS[k], linestyle=LINES[k % len(LINES)], label=modulation)
        for k, modulation in enumerate(papr_db)
    ]
    title = f"{name}: peaks of {n_symbols} symbols over their mean power"
    figure, (axes,) = panel_grid(1, [*lines, *theories], title, panel_in=(5.4, 3.4))
    for line, ratios in zip(lines, papr_db.values(), strict=True):
        share = 1 - np.arange(ratios.size) / ratios.size
        axes.step(np.sort(ratios), share, where="pre", color=line.get_color(), linestyle=line.get_linestyle())
    lowest = min(float(ratios.min()) for ratios in papr_db.values()) - 0.5
    highest = max(float(ratios.max()) for ratios in papr_db.values()) + 0.5
    level_db = np.linspace(lowest, highest, WIDE_POINTS)
    for oversampled, linestyle in ((True, "--"), (False, ":")):
        ccdf = papr_ccdf(level_db, system.n_subcarriers, oversampled=oversampled)
        axes.plot(level_db, ccdf, color=BOUND_COLOUR, linestyle=linestyle)
    axes.set(yscale="log", xlim=(lowest, highest), ylim=(0.5 / n_symbols, 1.3))
    axes.set(xlabel="peak-to-average power ratio [dB]", ylabel="share of symbols with higher peaks")
    axes.grid(True)
    return figure


def draw_resource_grid(name: str, grid: ResourceGrid) -> Figure:
    """Draw the places of the PRS: symbols of the frame, and elements of its first slot.

    Parameters
    ----------
    name : str
    grid : ResourceGrid

    Returns
    -------
    Figure
    """
    legend = [
        Patch(color=PRS_COLOUR, label="PRS"),
        Patch(color=DATA_COLOUR, label=f"data, {grid.modulation}"),
    ]
    title = f"{name}: resource grid, {100 * grid.is_prs.mean():.1f} % of its elements carry the PRS"
    figure = new_figure(10.0, 3.6, legend=legend, title=title)
    frame, slot = figure.subplots(1, 2, width_ratios=[1.6, 1])
    first = grid.is_prs[:SHOWN_SUBCARRIERS, :SLOT_SYMBOLS]
    _draw_elements(frame, np.any(grid.is_prs, axis=0, keepdims=True), grid.is_prs.shape)
    frame.set_title("frame: symbols with PRS")
    _draw_elements(slot, first, first.shape)
    slot.set_title("lowest subcarriers of the first slot")
    slot.set_xticks(np.arange(1, first.shape[1]) - 0.5, minor=True)
    slot.set_yticks(np.arange(1, first.shape[0]) - 0.5, minor=True)
    slot.grid(which="minor", color="white", linewidth=0.8)
    slot.tick_params(which="minor", length=0)
    slot.set_axisbelow(False)
    return figure


def _draw_whole(axes: Axes, system: System, colour: str, waveform: Waveform) -> float:
    """Draw the spectrum over three times its band; return the lowest level of theory."""
    spacing_hz, bandwidth_hz = system.subcarrier_spacing_hz, system.bandwidth_hz
    frequency_hz, density = measured_density(waveform, system, OVERSAMPLING, spacing_hz)
    shown = (frequency_hz > -bandwidth_hz) & (frequency_hz < 2 * bandwidth_hz)
    measured_db = _relative_db(density[shown], system)
    axes.plot(frequency_hz[shown] / 1e6, measured_db, color=colour, alpha=0.45, linewidth=0.8)
    # Denser where the density falls: at both edges of the band.
    distance_hz = bandwidth_hz * np.linspace(-1, 1, WIDE_POINTS) ** 3
    offset_hz = distance_hz[distance_hz > -bandwidth_hz / 2]
    theory_db = out_of_band_db(system, offset_hz)
    upper_hz = _upper_edge_hz(system) + offset_hz
    lower_hz = -0.5 * spacing_hz - offset_hz
    both_hz = np.concatenate([lower_hz[::-1], upper_hz])
    both_db = np.concatenate([theory_db[::-1], theory_db])
    axes.plot(both_hz / 1e6, both_db, color=colour, linestyle="--", linewidth=1.0)
    return float(theory_db.min())


def _draw_edge(axes: Axes, system: System, colour: str, waveform: Waveform) -> None:
    """Draw the upper edge of the band finely."""
    spacing_hz, edge_hz = system.subcarrier_spacing_hz, _upper_edge_hz(system)
    frequency_hz, density = measured_density(waveform, system, OVERSAMPLING, spacing_hz / 8)
    place = (frequency_hz - edge_hz) / spacing_hz
    shown = np.abs(place) <= EDGE_SPACINGS
    axes.plot(place[shown], _relative_db(density[shown], system), color=colour, alpha=0.45, linewidth=0.8)
    place = np.linspace(-EDGE_SPACINGS, EDGE_SPACINGS, NARROW_POINTS)
    theory_db = _relative_db(power_density(system, edge_hz + place * spacing_hz), system)
    axes.plot(place, theory_db, color=colour, linestyle="--", linewidth=1.0)


def _upper_edge_hz(system: System) -> float:
    return (system.n_subcarriers - 0.5) * system.subcarrier_spacing_hz


def _relative_db(density: Floats, system: System) -> Floats:
    """Convert a density to dB over its mean inside the band."""
    with np.errstate(divide="ignore"):
        level_db: Floats = 10 * np.log10(density * system.bandwidth_hz / mean_power(system))
    return level_db


def _draw_elements(axes: Axes, is_prs: NDArray[np.bool_], shape: tuple[int, ...]) -> None:
    """Fill axes of subcarriers by symbols with the colours of PRS and data."""
    n_subcarriers, n_symbols = shape
    axes.imshow(
        is_prs,
        cmap=ListedColormap([DATA_COLOUR, PRS_COLOUR]),
        vmin=0,
        vmax=1,
        aspect="auto",
        origin="lower",
        interpolation="nearest",
        extent=(-0.5, n_symbols - 0.5, -0.5, n_subcarriers - 0.5),
    )
    axes.set(xlabel="symbol", ylabel="subcarrier")
