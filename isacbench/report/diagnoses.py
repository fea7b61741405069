"""What estimators see on their way to an image: range-Doppler maps and angular spectra, computed anew."""

import warnings
from collections.abc import Iterator, Sequence
from itertools import zip_longest
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from isacbench.bench.compare.scenes import SCENE_KINDS
from isacbench.bench.plan.labels import estimator_labels
from isacbench.bench.store.run import Run
from isacbench.bench.suites.suite import Suite
from isacbench.charts import Axis, Chart, ChartGroup, LineStyle, Series, Variant, nearest_values, variants_in
from isacbench.errors import InputError, InputWarning
from isacbench.files.escaping import counted, file_stems
from isacbench.model.echo import Simulator
from isacbench.model.numerology import System
from isacbench.model.observation import Observation
from isacbench.model.scene import Scenario
from isacbench.plugins.contracts import Diagnoser, Diagnosis, Estimator, Spectrum
from isacbench.plugins.registry import build_variants, canonical_params
from isacbench.report.clouds import best_variants
from isacbench.report.figures import THRESHOLD, draw_charts, drawable, new_figure
from isacbench.report.html.page_content import SHOWN_SNR_DB

Floats = NDArray[np.floating]

POWER = "power over noise [dB]"

LOWEST_RATIO = 0.01
"""Lowest shown ratio of power to noise: one look at noise can be arbitrarily weak."""

LOWEST_DB = -300.0
"""Lowest level of a spectrum in a page, which needs no weaker ones."""

MOST_MAPS = 6
"""Images of a page of which maps and spectra are computed; the page says how many it leaves out."""

SPECTRUM = LineStyle("#404040", "solid", "")
THRESHOLD_STYLE = LineStyle(THRESHOLD, "dash", "")
PEAK = LineStyle("#0072B2", "", "triangle-down")
TRUE = LineStyle("#009E73", "", "line-ns")
HALF_BIN = 0.5


class Diagnosed(NamedTuple):
    """Diagnosis of an image: its scenario, label of its estimator, and power of noise in a map's cell."""

    scenario: str
    label: str
    diagnosis: Diagnosis
    noise_power: float


def find_diagnoses(
    run: Run, scenarios: Sequence[str], snr_db: float, trial: int, most: int | None = None
) -> tuple[list[Diagnosed], int]:
    """Diagnose images of a run at one SNR and trial again, at most so many, and count those left out.

    Every scenario comes before any has a second estimator; of many estimators the 16 best come. An estimator
    that is not installed, or whose diagnosis fails, is left out with a warning.
    """
    labels, diagnosers = estimator_labels(variants_in(run.rows)), _diagnosers(run.suite)
    own = {name: run.rows[run.rows["scenario"] == name] for name in scenarios}
    rounds = zip_longest(
        *([(name, one) for one in best_variants(own[name], list(diagnosers))] for name in scenarios)
    )
    wanted = [cell for cells in rounds for cell in cells if cell is not None]
    observed: dict[str, tuple[Observation, float]] = {}
    found = []
    for name, variant in wanted[:most]:
        if name not in observed:
            simulator = Simulator(run.scenarios[name])
            observation = simulator.observe(snr_db, trial, run.suite.seed)
            observed[name] = observation, simulator.noise_power(snr_db)
        observation, noise_power = observed[name]
        label = labels.get(variant, variant[0])
        try:
            diagnosis = diagnosers[variant].diagnose(observation)
        except Exception as error:  # a plugin's fault must not cost the others
            _warn_of_fault(label, error)
        else:
            found.append(Diagnosed(name, label, diagnosis, noise_power))
    return found, len(wanted) - len(wanted[:most])


def _diagnosers(suite: Suite) -> dict[Variant, Diagnoser]:
    """Estimators of a suite that show their work, as far as they are installed."""
    found: dict[Variant, Diagnoser] = {}
    for spec in suite.estimators:
        try:
            plugins: list[Estimator] = [plugin for _, plugin in build_variants("estimator", spec)]
        except InputError as error:
            warnings.warn(f"no map and no spectra of {spec}: {error}", InputWarning, stacklevel=4)
            continue
        for plugin in plugins:
            if isinstance(plugin, Diagnoser):
                found[plugin.name, canonical_params(plugin)] = plugin
    return found


def _warn_of_fault(label: str, error: Exception) -> None:
    reason = f"{type(error).__name__}: {error}"
    warnings.warn(f"no map and no spectra of {label}: {reason}", InputWarning, stacklevel=3)


def diagnosed_maps(run: Run) -> dict[str, Any]:
    """Compute maps and spectra for a page, of estimators that show their work and a few images of a run.

    The dictionary has ``maps``, each with its scene, estimator (label), SNR and trial, axes, power, threshold
    and mask, and spectra; and ``left_out``, the number of images beyond the first six. What cannot be shown
    costs its own map with a warning.
    """
    if run.kind not in SCENE_KINDS or run.rows.empty:
        return {}
    (snr_db,) = nearest_values(sorted(run.rows["snr_db"].unique()), [SHOWN_SNR_DB])
    trial = int(run.rows["trial"].min())
    names = [name for name in dict.fromkeys(run.rows["scenario"].astype(object)) if name in run.scenarios]
    diagnoses, n_left_out = find_diagnoses(run, names, snr_db, trial, MOST_MAPS)
    found: list[dict[str, Any]] = []
    for name, label, diagnosis, noise_power in diagnoses:
        own = {"scene": name, "estimator": label, "snr_db": float(snr_db), "trial": trial}
        try:
            found.append(own | _page_map(diagnosis, run.scenarios[name].system, noise_power))
        except Exception as error:  # a plugin may return anything
            _warn_of_fault(label, error)
    return {"maps": found, "left_out": n_left_out}


def _page_map(diagnosis: Diagnosis, system: System, noise_power: float) -> dict[str, Any]:
    """A map in terms of JSON: power and threshold over noise, and what was detected."""
    spectra = []
    for spectrum in diagnosis.spectra:
        threshold_db = None
        if spectrum.threshold_db is not None:
            threshold_db = _rounded(np.broadcast_to(spectrum.threshold_db, spectrum.cosine.shape), 2)
        spectra.append(
            {
                "label": str(spectrum.label),
                "cosine": _rounded(spectrum.cosine, 4),
                "level_db": _rounded(np.maximum(spectrum.level_db, LOWEST_DB), 2),
                "threshold_db": threshold_db,
                "peaks": _rounded(spectrum.peaks, 4),
            }
        )
    return {
        "range_m": _rounded(diagnosis.range_bins * system.range_bin_m, 3),
        "velocity_mps": _rounded(diagnosis.doppler_bins * system.velocity_bin_mps, 3),
        "power_db": _rounded(_decibels(diagnosis.power / noise_power), 1),
        "threshold_db": _rounded(_decibels(diagnosis.detection.threshold / noise_power), 1),
        "mask": np.asarray(diagnosis.detection.mask, dtype=int).tolist(),
        "spectra": spectra,
    }


def _rounded(values: Any, digits: int) -> list[Any]:
    """Round numbers for JSON, None for what is not finite."""
    numbers = np.round(np.asarray(values, dtype=float), digits)
    found: list[Any] = np.ma.masked_invalid(numbers).tolist()
    return found


def _decibels(ratio: Floats) -> Floats:
    decibels: Floats = 10 * np.log10(np.maximum(ratio, LOWEST_RATIO))
    return decibels


def diagnosis_figures(run: Run, scenario: str, snr_db: float, trial: int) -> Iterator[tuple[str, Figure]]:
    """Draw map and spectra of every estimator that shows its work, by the stems of their files."""
    found, scene = find_diagnoses(run, [scenario], snr_db, trial)[0], run.scenarios[scenario]
    stems = file_stems([f"{scenario} {one.label} {snr_db:g}dB trial{trial}" for one in found])
    for one, stem in zip(found, stems.values(), strict=True):
        title = f"{scenario}, {one.label}, {snr_db:g} dB, trial {trial}"
        yield f"rdm-{stem}", draw_map(drawable(title), one.diagnosis, scene.system, one.noise_power)
        if one.diagnosis.spectra:
            yield f"spectrum-{stem}", draw_charts(spectrum_charts(title, one.diagnosis, scene))


def draw_map(title: str, diagnosis: Diagnosis, system: System, noise_power: float) -> Figure:
    """Draw a range-Doppler map, its threshold, the detected cells, and a cut through the strongest.

    `system` turns bins into metres and metres a second; `noise_power` is the power that counts as 0 dB.
    """
    power_db = _decibels(diagnosis.power / noise_power)
    threshold_db = _decibels(diagnosis.detection.threshold / noise_power)
    mask = diagnosis.detection.mask
    range_m = diagnosis.range_bins * system.range_bin_m
    velocity_mps = diagnosis.doppler_bins * system.velocity_bin_mps
    figure = new_figure(12.0, 4.3, title=title)
    *panels, cut = figure.subplots(1, 4, width_ratios=(1, 1, 1, 1.9))
    limits = float(min(power_db.min(), threshold_db.min())), float(power_db.max())
    extent = (*_borders(velocity_mps), *_borders(range_m))
    detected_db = np.where(mask, power_db, np.nan)
    maps = {"power": power_db, "threshold": threshold_db, "power where detected": detected_db}
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
    panels[0].axhline(range_m[row], color="w", linewidth=0.8, linestyle=":")
    cut.set_title(f"cut at the strongest range, {range_m[row]:.1f} m")
    cut.plot(velocity_mps, power_db[row], color="0.35", marker="o", markersize=3, label="power")
    found = velocity_mps[mask[row]], power_db[row, mask[row]]
    cut.plot(*found, "o", color="#0072B2", markersize=5.5, label="detected")
    cut.plot(velocity_mps, threshold_db[row], color=THRESHOLD, linestyle="--", label="threshold")
    cut.set(xlabel="radial velocity [m/s]", ylabel=POWER)
    cut.grid(True)
    cut.legend(loc="upper right")
    return figure


def _borders(centres: Floats) -> tuple[float, float]:
    """Outer borders of evenly spaced cells."""
    half = (centres[-1] - centres[0]) / max(2 * (centres.size - 1), 1) or 0.5
    return float(centres[0] - half), float(centres[-1] + half)


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
