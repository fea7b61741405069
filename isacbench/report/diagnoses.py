"""What estimators see on their way to an image: range-Doppler maps and angular spectra, computed anew."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from isacbench.bench.plan.labels import estimator_labels
from isacbench.charts import Axis, Chart, ChartGroup, LineStyle, Series, variants_in
from isacbench.errors import InputError, InputWarning
from isacbench.files.escaping import counted
from isacbench.files.file_names import file_stems
from isacbench.model.echo import Simulator
from isacbench.plugins.contracts import Diagnoser, Estimator
from isacbench.plugins.registry import build_variants, canonical_params
from isacbench.report.clouds import best_variants
from isacbench.report.figures import THRESHOLD, draw_charts, drawable, new_figure

if TYPE_CHECKING:
    from collections.abc import Iterator

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from isacbench.bench.store.run import Run
    from isacbench.bench.suites.suite import Suite
    from isacbench.charts import Variant
    from isacbench.model.numerology import System
    from isacbench.model.observation import Observation
    from isacbench.model.scene import Scenario
    from isacbench.plugins.contracts import Diagnosis, Spectrum

    Floats = NDArray[np.floating]


class Diagnosed(NamedTuple):
    """Diagnosis of one image.

    Attributes
    ----------
    label : str
        Of the estimator.
    noise_power : float
        Power of noise in a cell of the map.
    """

    label: str
    diagnosis: Diagnosis
    noise_power: float


class Diagnoses:
    """Diagnoses of the images of a run at one SNR and trial.

    It warns if an estimator of the run is not installed.
    """

    def __init__(self, run: Run, snr_db: float, trial: int) -> None:
        self._run, self._snr_db, self._trial = run, snr_db, trial
        self._diagnosers = _diagnosers(run.suite)
        self._labels = estimator_labels(variants_in(run.rows))
        self._observed: dict[str, tuple[Observation, float]] = {}

    def variants(self, scenario: str) -> list[Variant]:
        """List the estimators that show their work on a scenario: of many the 16 best."""
        own = self._run.rows[self._run.rows["scenario"] == scenario]
        return best_variants(own, list(self._diagnosers))

    def of(self, scenario: str, variant: Variant) -> Diagnosed | None:
        """Diagnose one image; None with a warning if that fails."""
        label = self._labels.get(variant, variant[0])
        observation, noise_power = self._observe(scenario)
        try:
            diagnosis = self._diagnosers[variant].diagnose(observation)
        except Exception as error:  # a plugin's fault must not cost the others
            warn_of_fault(label, error)
            return None
        return Diagnosed(label, diagnosis, noise_power)

    def _observe(self, scenario: str) -> tuple[Observation, float]:
        """Observation and its noise power, made once a scenario."""
        if scenario not in self._observed:
            simulator = Simulator(self._run.scenarios[scenario])
            observation = simulator.observe(self._snr_db, self._trial, self._run.suite.seed)
            self._observed[scenario] = observation, simulator.noise_power(self._snr_db)
        return self._observed[scenario]


def warn_of_fault(label: str, error: Exception) -> None:
    """Warn that the diagnosis of an estimator, given by its label, failed or cannot be shown."""
    reason = f"{type(error).__name__}: {error}"
    warnings.warn(f"no map and no spectra of {label}: {reason}", InputWarning, stacklevel=3)


def diagnosis_figures(run: Run, scenario: str, snr_db: float, trial: int) -> Iterator[tuple[str, Figure]]:
    """Draw map and spectra of every estimator that shows its work, by the stems of their files."""
    diagnoses = Diagnoses(run, snr_db, trial)
    found = [diagnoses.of(scenario, variant) for variant in diagnoses.variants(scenario)]
    seen, scene = [one for one in found if one is not None], run.scenarios[scenario]
    stems = file_stems([f"{scenario} {one.label} {snr_db:g}dB trial{trial}" for one in seen])
    for one, stem in zip(seen, stems.values(), strict=True):
        title = f"{scenario}, {one.label}, {snr_db:g} dB, trial {trial}"
        yield f"rdm-{stem}", draw_map(drawable(title), one.diagnosis, scene.system, one.noise_power)
        if one.diagnosis.spectra:
            yield f"spectrum-{stem}", draw_charts(spectrum_charts(title, one.diagnosis, scene))


def _diagnosers(suite: Suite) -> dict[Variant, Diagnoser]:
    """Estimators of a suite that show their work, as far as they are installed."""
    found: dict[Variant, Diagnoser] = {}
    for spec in suite.estimators:
        try:
            plugins: list[Estimator] = [plugin for _, plugin in build_variants("estimator", spec)]
        except InputError as error:
            warnings.warn(f"no map and no spectra of {spec}: {error}", InputWarning, stacklevel=3)
            continue
        found |= {
            (plugin.name, canonical_params(plugin)): plugin
            for plugin in plugins
            if isinstance(plugin, Diagnoser)
        }
    return found


POWER = "power over noise [dB]"

LOWEST_RATIO = 0.01
"""Lowest drawn ratio of power to noise: one look at noise can be arbitrarily weak."""


def draw_map(title: str, diagnosis: Diagnosis, system: System, noise_power: float) -> Figure:
    """Draw a range-Doppler map, its threshold, the detected cells, and a cut through the strongest.

    Parameters
    ----------
    system : System
        Turns bins into metres and metres a second.
    noise_power : float
        Power that counts as 0 dB.
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


SPECTRUM = LineStyle("#404040", "solid", "")
THRESHOLD_STYLE = LineStyle(THRESHOLD, "dash", "")
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
        series.append(Series("threshold", spectrum.cosine, threshold_db, style=THRESHOLD_STYLE))
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
