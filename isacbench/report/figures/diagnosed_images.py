"""Diagnoses of images of a stored run: what its estimators see on their way, computed anew."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, NamedTuple

from isacbench.bench.plan.labels import estimator_labels
from isacbench.charts import variants_in
from isacbench.errors import InputError, InputWarning
from isacbench.files.file_names import file_stems
from isacbench.model.echo import Simulator
from isacbench.plugins.contracts import Diagnoser, Estimator
from isacbench.plugins.parameters import canonical_params
from isacbench.plugins.registry import build_variants
from isacbench.report.drawing.chart_figures import draw_charts
from isacbench.report.drawing.style import drawable
from isacbench.report.figures.map_figures import draw_map
from isacbench.report.figures.run_figures import best_variants
from isacbench.report.figures.spectrum_figures import spectrum_charts

if TYPE_CHECKING:
    from collections.abc import Iterator

    from isacbench.bench.store.run import Run
    from isacbench.bench.suites.suite import Suite
    from isacbench.charts import Variant
    from isacbench.model.observation import Observation
    from isacbench.plugins.contracts import Diagnosis
    from isacbench.report.figures.run_figures import NamedFigure


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


def diagnosis_figures(run: Run, scenario: str, snr_db: float, trial: int) -> Iterator[NamedFigure]:
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
