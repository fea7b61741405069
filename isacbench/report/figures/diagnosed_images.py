"""Diagnoses of an image of a stored run: what its estimators see on their way, computed anew."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, NamedTuple

from isacbench.bench.plan.labels import estimator_labels
from isacbench.errors import InputError, InputWarning
from isacbench.model.echo import Simulator
from isacbench.plugins.contracts import Diagnoser
from isacbench.plugins.registry import build_estimators_of, canonical_params
from isacbench.report.drawing.style import drawable, file_stems
from isacbench.report.figures.map_figures import draw_map
from isacbench.report.figures.run_figures import best_variants
from isacbench.report.figures.spectrum_figures import draw_spectra

if TYPE_CHECKING:
    from collections.abc import Iterator

    from isacbench.bench.cells.record import Results
    from isacbench.bench.plan.labels import Variant
    from isacbench.plugins.contracts import Diagnosis
    from isacbench.report.figures.curves import NamedFigure


class Diagnosed(NamedTuple):
    """Diagnosis of one image.

    Attributes
    ----------
    label : str
        Of the estimator.
    diagnosis : Diagnosis
    noise_power : float
        Power of noise in a cell of the map.
    """

    label: str
    diagnosis: Diagnosis
    noise_power: float


def diagnosed_images(results: Results, scenario: str, snr_db: float, trial: int) -> Iterator[Diagnosed]:
    """Diagnose the image of one cell by every estimator that shows its work, of many by the 16 best.

    Parameters
    ----------
    results : Results
        Of images.
    scenario : str
        Its name.
    snr_db : float
    trial : int

    Yields
    ------
    Diagnosed

    Warns
    -----
    InputWarning
        If an estimator of the run is not installed, or its diagnosis fails.
    """
    found = _diagnosers(results)
    labels = estimator_labels(zip(results.records["estimator"], results.records["params"], strict=True))
    records = results.records[results.records["scenario"] == scenario]
    simulator = Simulator(results.scenarios[scenario])
    if not found:
        return
    observation = simulator.observe(snr_db, trial, results.suite.seed)
    for variant in best_variants(records, list(found)):
        label = labels.get(variant, variant[0])
        try:
            diagnosis = found[variant].diagnose(observation)
        except Exception as error:  # a plugin's fault must not cost the others
            reason = f"{type(error).__name__}: {error}"
            warnings.warn(f"no map and no spectra of {label}: {reason}", InputWarning, stacklevel=2)
            continue
        yield Diagnosed(label, diagnosis, simulator.noise_power(snr_db))


def diagnosis_figures(results: Results, scenario: str, snr_db: float, trial: int) -> Iterator[NamedFigure]:
    """Draw map and spectra of every estimator that shows its work.

    Parameters
    ----------
    results : Results
    scenario : str
    snr_db : float
    trial : int

    Yields
    ------
    stem : str
        Of the file.
    figure : Figure

    Warns
    -----
    InputWarning
        As `diagnosed_images` warns.
    """
    scene = results.scenarios[scenario]
    seen = list(diagnosed_images(results, scenario, snr_db, trial))
    stems = file_stems([f"{scenario} {one.label} {snr_db:g}dB trial{trial}" for one in seen])
    for one, stem in zip(seen, stems.values(), strict=True):
        title = drawable(f"{scenario}, {one.label}, {snr_db:g} dB, trial {trial}")
        yield f"rdm-{stem}", draw_map(title, one.diagnosis, scene.system, one.noise_power)
        if one.diagnosis.spectra:
            yield f"spectrum-{stem}", draw_spectra(title, one.diagnosis, scene)


def _diagnosers(results: Results) -> dict[Variant, Diagnoser]:
    """Estimators of a run that show their work, as far as they are installed."""
    found: dict[Variant, Diagnoser] = {}
    for spec in results.suite.estimators:
        try:
            plugins = [plugin for _, plugin in build_estimators_of(spec)]
        except InputError as error:
            warnings.warn(f"no map and no spectra of {spec}: {error}", InputWarning, stacklevel=3)
            continue
        found |= {
            (plugin.name, canonical_params(plugin)): plugin
            for plugin in plugins
            if isinstance(plugin, Diagnoser)
        }
    return found
