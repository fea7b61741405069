"""Angular spectra of one range-Doppler cell."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from isacbench.charts import Axis, Chart, ChartGroup, LineStyle, Series
from isacbench.files.escaping import counted

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from isacbench.model.scene import Scenario
    from isacbench.plugins.contracts import Diagnosis, Spectrum

SPECTRUM = LineStyle("#404040", "solid", "")
THRESHOLD = LineStyle("#D55E00", "dash", "")
PEAK = LineStyle("#0072B2", "", "triangle-down")
TRUE = LineStyle("#009E73", "", "line-ns")
HALF_BIN = 0.5


def spectrum_charts(title: str, diagnosis: Diagnosis, scenario: Scenario) -> ChartGroup:
    """Spectra of the cell of a diagnosis with threshold and peaks, and the true directions in it."""
    if diagnosis.cell is None:
        raise ValueError("a figure of spectra takes a diagnosis with a cell")
    range_bin, doppler_bin = diagnosis.cell
    true = _true_cosines(scenario, range_bin, doppler_bin)
    range_m = range_bin * scenario.system.range_bin_m
    velocity_mps = doppler_bin * scenario.system.velocity_bin_mps
    cell = f"strongest cell: {range_m:.1f} m, {velocity_mps:.1f} m/s, {counted(true['u'].size, 'scatterer')}"
    if diagnosis.separated is False:
        cell += ", signal and noise subspaces not separated"
    charts = [_chart(spectrum, true[spectrum.label]) for spectrum in diagnosis.spectra]
    return ChartGroup("spectrum", f"{title}\n{cell}", charts, len(charts), panel_in=(4.6, 2.6))


def _chart(spectrum: Spectrum, true: NDArray[np.float64]) -> Chart:
    levels_db = np.interp(spectrum.peaks, spectrum.cosine, spectrum.level_db)
    series = [Series("spectrum", spectrum.cosine, spectrum.level_db, style=SPECTRUM)]
    if spectrum.threshold_db is not None:
        threshold_db = np.broadcast_to(spectrum.threshold_db, spectrum.cosine.shape)
        series.append(Series("threshold", spectrum.cosine, threshold_db, style=THRESHOLD))
    floor_db = np.full(true.size, np.min(spectrum.level_db))
    series += [
        Series("peak taken for an echo", spectrum.peaks, levels_db, mark="points", style=PEAK),
        Series("true scatterer of the cell", true, floor_db, mark="points", style=TRUE),
    ]
    axis = Axis(f"direction cosine {spectrum.label}")
    return Chart("", axis, Axis("spectrum level [dB]"), series)


def _true_cosines(scenario: Scenario, range_bin: int, doppler_bin: int) -> dict[str, NDArray[np.float64]]:
    """Direction cosines of the scatterers within half a bin of a cell, by name."""
    offset_m = scenario.scatterers.xyz - scenario.base_station_m
    range_bins = np.linalg.norm(offset_m, axis=1) / scenario.system.range_bin_m
    doppler_bins = scenario.scatterers.velocity / scenario.system.velocity_bin_mps
    inside = (np.abs(range_bins - range_bin) <= HALF_BIN) & (np.abs(doppler_bins - doppler_bin) <= HALF_BIN)
    u, w = scenario.frame.direction_cosines(offset_m[inside])
    return {"u": u, "w": w}
