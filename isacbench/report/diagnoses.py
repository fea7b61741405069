"""What estimators see on their way to an image: range-Doppler maps and angular spectra, computed anew."""

import warnings
from collections.abc import Iterator, Sequence
from functools import cache, partial
from itertools import zip_longest
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from isacbench.bench.labels import estimator_labels
from isacbench.bench.store.run import Run
from isacbench.bench.suites.suite import Suite
from isacbench.bench.suites.suite_kinds import KINDS
from isacbench.charts import Axis, Chart, ChartGroup, LineStyle, Series, Variant, variants_in
from isacbench.checked_arrays import Floats, Mask, checked_array
from isacbench.errors import InputError, InputWarning
from isacbench.files.escaping import file_stems, plural
from isacbench.model.echo import Simulator
from isacbench.model.kernels import within_period
from isacbench.model.observation import Observation
from isacbench.model.scene import Scenario
from isacbench.plugins.contracts import Diagnoser, Diagnosis, Estimator, Spectrum
from isacbench.plugins.registry import build_variants, canonical_params
from isacbench.report.clouds import best_variants, shown_snr_db
from isacbench.report.figures import THRESHOLD, Drawing, draw_charts, drawable, new_figure

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
    """Diagnosis of an image, and its map: power and threshold over noise."""

    scenario: Scenario
    label: str
    diagnosis: Diagnosis
    range_m: Floats
    velocity_mps: Floats
    power_db: Floats
    threshold_db: Floats
    mask: Mask
    spectra: Sequence[Spectrum]


def over_noise(scenario: Scenario, label: str, diagnosis: Diagnosis, noise_power: float) -> Diagnosed:
    """Scale the map of a diagnosis: its axes, and its powers over that of noise in a cell.

    A plugin made it: InputError, or what NumPy raises, if it is not what `Diagnosis` says.
    """
    detection = diagnosis.detection
    range_bins = _numbers("range_bins", diagnosis.range_bins)
    doppler_bins = _numbers("doppler_bins", diagnosis.doppler_bins)
    shape = range_bins.size, doppler_bins.size
    powers = _numbers("power", diagnosis.power, shape), _numbers("threshold", detection.threshold, shape)
    if not np.isfinite(powers[0]).any():
        raise InputError("power has no finite number; allowed is one at least")
    spectra = [_checked_spectrum(spectrum) for spectrum in diagnosis.spectra]
    if spectra:
        _numbers("cell", diagnosis.cell, (2,))
    power_db, threshold_db = (10 * np.log10(np.maximum(one / noise_power, LOWEST_RATIO)) for one in powers)
    return Diagnosed(
        scenario,
        label,
        diagnosis,
        range_bins * scenario.system.range_bin_m,
        doppler_bins * scenario.system.velocity_bin_mps,
        power_db,
        threshold_db,
        _numbers("mask", np.asarray(detection.mask, dtype=np.float64), shape) != 0,
        spectra,
    )


def _checked_spectrum(given: Spectrum) -> Spectrum:
    """Spectrum whose threshold is an array, if it has one."""
    cosine, threshold_db = _numbers("cosine", given.cosine), given.threshold_db
    if given.label not in ("u", "w") or not cosine.size:
        raise InputError(
            f"spectrum along {given.label!r} with {cosine.size} cosines; allowed are 'u' and 'w'"
        )
    if threshold_db is not None:
        threshold_db = np.broadcast_to(checked_array("threshold_db", threshold_db), cosine.shape)
    level_db = _numbers("level_db", given.level_db, cosine.shape)
    peaks = _on_axis(_numbers("peaks", given.peaks), cosine)
    return Spectrum(cosine, level_db, threshold_db, peaks, given.label)


def _on_axis(places: Floats, cosine: Floats) -> Floats:
    """Aliases of directions that are nearest to the middle of the cosines of a spectrum."""
    return within_period(places, float(cosine[0] + cosine[-1]) / 2)


def _numbers(what: str, values: Any, shape: tuple[int, ...] | None = None) -> Floats:
    """Numbers of a shape; without one, finite numbers in a row."""
    array = checked_array(what, values)
    if array.shape != shape if shape else array.ndim != 1 or not np.isfinite(array).all():
        allowed = shape or "finite numbers in a row"
        raise InputError(f"{what} has shape {array.shape}; allowed: {allowed}")
    return array


def find_diagnoses(
    run: Run, scenarios: Sequence[str], snr_db: float, trial: int, most: int | None = None
) -> tuple[list[Diagnosed], int]:
    """Diagnose images of a run at one SNR and trial again, at most so many, and count those left out.

    Every scenario comes before any has a second estimator; of many estimators the 16 best come. An estimator
    that is not installed, or whose diagnosis fails, is left out with a warning.
    """

    @cache
    def observe(name: str) -> tuple[Observation, float]:
        simulator = Simulator(run.scenarios[name])
        return simulator.observe(snr_db, trial, run.suite.seed), simulator.noise_power(snr_db)

    labels, diagnosers = estimator_labels(variants_in(run.rows)), _diagnosers(run.suite)
    of_scenario = (
        [(name, one) for one in best_variants(run.rows[run.rows["scenario"] == name], list(diagnosers))]
        for name in scenarios
    )
    wanted = [cell for cells in zip_longest(*of_scenario) for cell in cells if cell is not None]
    diagnoses = []
    for name, variant in wanted[:most]:
        label = labels.get(variant, variant[0])
        observation, noise_power = observe(name)
        try:
            diagnosis = diagnosers[variant].diagnose(observation)
            diagnoses.append(over_noise(run.scenarios[name], label, diagnosis, noise_power))
        except Exception as error:  # a plugin's fault must not cost the others
            reason = f"{type(error).__name__}: {error}"
            warnings.warn(f"no map and no spectra of {label}: {reason}", InputWarning, stacklevel=2)
    return diagnoses, len(wanted) - len(wanted[:most])


def _diagnosers(suite: Suite) -> dict[Variant, Diagnoser]:
    """Estimators of a suite that show their work, as far as they are installed."""
    diagnosers: dict[Variant, Diagnoser] = {}
    for spec in suite.estimators:
        try:
            plugins: list[Estimator] = [plugin for _, plugin in build_variants("estimator", spec)]
        except InputError as error:
            warnings.warn(f"no map and no spectra of {spec}: {error}", InputWarning, stacklevel=4)
            continue
        for plugin in plugins:
            if isinstance(plugin, Diagnoser):
                diagnosers[plugin.name, canonical_params(plugin)] = plugin
    return diagnosers


def diagnosed_maps(run: Run) -> dict[str, Any]:
    """Compute maps and spectra for a page, of estimators that show their work and a few images of a run.

    The dictionary has ``maps``, each with its scene, estimator (label), SNR and trial, axes, power, threshold
    and mask, and spectra; and ``left_out``, the number of images beyond the first six.
    """
    if not KINDS[run.kind].has_images or run.rows.empty:
        return {}
    snr_db, trial = shown_snr_db(run.rows), int(run.rows["trial"].min())
    names = [name for name in dict.fromkeys(run.rows["scenario"].astype(object)) if name in run.scenarios]
    diagnoses, n_left_out = find_diagnoses(run, names, snr_db, trial, MOST_MAPS)
    maps = [
        {
            "scene": one.scenario.name,
            "estimator": one.label,
            "snr_db": float(snr_db),
            "trial": trial,
            "range_m": _rounded(one.range_m, 3),
            "velocity_mps": _rounded(one.velocity_mps, 3),
            "power_db": _rounded(one.power_db, 1),
            "threshold_db": _rounded(one.threshold_db, 1),
            "mask": one.mask.astype(int).tolist(),
            "spectra": [_page_spectrum(spectrum) for spectrum in one.spectra],
        }
        for one in diagnoses
    ]
    return {"maps": maps, "left_out": n_left_out}


def _page_spectrum(spectrum: Spectrum) -> dict[str, Any]:
    threshold_db = spectrum.threshold_db
    return {
        "label": spectrum.label,
        "cosine": _rounded(spectrum.cosine, 4),
        "level_db": _rounded(np.maximum(spectrum.level_db, LOWEST_DB), 2),
        "threshold_db": None if threshold_db is None else _rounded(threshold_db, 2),
        "peaks": _rounded(spectrum.peaks, 4),
    }


def _rounded(values: Any, digits: int) -> list[Any]:
    """Round numbers for JSON, None for what is not finite."""
    numbers = np.round(np.asarray(values, dtype=float), digits)
    listed: list[Any] = np.ma.masked_invalid(numbers).tolist()
    return listed


def diagnosis_figures(run: Run, scenario: str, snr_db: float, trial: int) -> Iterator[Drawing]:
    """Draw map and spectra of every estimator that shows its work, by the stems of their files."""
    diagnoses, _ = find_diagnoses(run, [scenario], snr_db, trial)
    stems = file_stems([f"{scenario} {one.label} {snr_db:g}dB trial{trial}" for one in diagnoses])
    for one, stem in zip(diagnoses, stems.values(), strict=True):
        title = f"{scenario}, {one.label}, {snr_db:g} dB, trial {trial}"
        yield f"rdm-{stem}", partial(draw_map, drawable(title), one)
        if one.spectra:
            yield f"spectrum-{stem}", partial(draw_charts, spectrum_charts(title, one))


def draw_map(title: str, one: Diagnosed) -> Figure:
    """Draw a range-Doppler map, its threshold, and the power of the detected cells."""
    figure = new_figure(9.0, 4.3, title=title)
    panels = figure.subplots(1, 3, sharex=True, sharey=True)
    finite = [values[np.isfinite(values)] for values in (one.power_db, one.threshold_db)]
    limits = np.concatenate(finite).min(), finite[0].max()
    extent = (*_borders(one.velocity_mps), *_borders(one.range_m))
    detected_db = np.where(one.mask, one.power_db, np.nan)
    maps = {"power": one.power_db, "threshold": one.threshold_db, "power where detected": detected_db}
    for axes, (name, values) in zip(panels, maps.items(), strict=True):
        image = axes.imshow(values, origin="lower", aspect="auto", extent=extent, clim=limits)
        axes.set(title=name, xlabel="radial velocity [m/s]")
    panels[0].set_ylabel("range [m]")
    figure.colorbar(image, ax=panels, label="power over noise [dB]")
    return figure


def _borders(centres: Floats) -> tuple[float, float]:
    """Outer borders of evenly spaced cells."""
    half = (centres[-1] - centres[0]) / max(2 * (centres.size - 1), 1) or 0.5
    return float(centres[0] - half), float(centres[-1] + half)


def spectrum_charts(title: str, one: Diagnosed) -> ChartGroup:
    """Spectra of the cell of a diagnosis with threshold and peaks, and the true directions in it."""
    system = one.scenario.system
    assert one.diagnosis.cell is not None  # as there are spectra
    range_bin, doppler_bin = one.diagnosis.cell
    true = _true_cosines(one.scenario, range_bin, doppler_bin)
    cell = f"strongest cell: {range_bin * system.range_bin_m:.1f} m"
    cell += f", {doppler_bin * system.velocity_bin_mps:.1f} m/s, {plural(true['u'].size, 'scatterer')}"
    if one.diagnosis.separated is False:
        cell += ", signal and noise subspaces not separated"
    charts = []
    for spectrum in one.spectra:
        own, level_db = _on_axis(true[spectrum.label], spectrum.cosine), spectrum.level_db
        peaks_db = np.interp(spectrum.peaks, spectrum.cosine, level_db)
        floor_db = np.full(own.size, np.min(level_db))
        series = [Series("spectrum", spectrum.cosine, level_db, style=SPECTRUM)]
        if spectrum.threshold_db is not None:
            series.append(Series("threshold", spectrum.cosine, spectrum.threshold_db, style=THRESHOLD_STYLE))
        series += [
            Series("peak taken for an echo", spectrum.peaks, peaks_db, mark="points", style=PEAK),
            Series("true scatterer of the cell", own, floor_db, mark="points", style=TRUE),
        ]
        axis = Axis(f"direction cosine {spectrum.label}")
        charts.append(Chart("", axis, Axis("spectrum level [dB]"), series))
    return ChartGroup("spectrum", f"{title}\n{cell}", charts, len(charts), panel_in=(4.6, 2.6))


def _true_cosines(scenario: Scenario, range_bin: int, doppler_bin: int) -> dict[str, NDArray[np.float64]]:
    """Direction cosines of the scatterers within half a bin of a cell, by name."""
    offset_m = scenario.scatterers.xyz - scenario.base_station_m
    range_bins = np.linalg.norm(offset_m, axis=1) / scenario.system.range_bin_m
    doppler_bins = scenario.scatterers.velocity / scenario.system.velocity_bin_mps
    inside = (np.abs(range_bins - range_bin) <= HALF_BIN) & (np.abs(doppler_bins - doppler_bin) <= HALF_BIN)
    return dict(zip("uw", scenario.frame.direction_cosines(offset_m[inside]), strict=True))
