"""Diagnoses of images of a stored run: what its estimators see on their way, computed anew."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, NamedTuple

from isacbench.bench.plan.labels import estimator_labels
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
    from collections.abc import Iterator, Mapping

    import pandas as pd

    from isacbench.bench.cells.record import Results
    from isacbench.bench.suites.suite import Suite
    from isacbench.charts import Variant
    from isacbench.model.observation import Observation
    from isacbench.model.scene import Scenario
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

    Parameters
    ----------
    suite : Suite
        Of images.
    records : DataFrame
        Rows of the run.
    scenarios : mapping of str to Scenario
    snr_db : float
    trial : int

    Warns
    -----
    InputWarning
        If an estimator of the run is not installed.
    """

    def __init__(
        self,
        suite: Suite,
        records: pd.DataFrame,
        scenarios: Mapping[str, Scenario],
        snr_db: float,
        trial: int,
    ) -> None:
        self._records, self._scenarios = records, scenarios
        self._snr_db, self._trial, self._seed = snr_db, trial, suite.seed
        self._diagnosers = _diagnosers(suite)
        self._labels = estimator_labels(zip(records["estimator"], records["params"], strict=True))
        self._observed: dict[str, tuple[Observation, float]] = {}

    def variants(self, scenario: str) -> list[Variant]:
        """List the estimators that show their work on a scenario: of many the 16 best.

        Parameters
        ----------
        scenario : str

        Returns
        -------
        list of (str, str)
            Names and parameters.
        """
        own = self._records[self._records["scenario"] == scenario]
        return best_variants(own, list(self._diagnosers))

    def of(self, scenario: str, variant: Variant) -> Diagnosed | None:
        """Diagnose one image.

        Parameters
        ----------
        scenario : str
        variant : (str, str)

        Returns
        -------
        Diagnosed or None
            None if the diagnosis fails.

        Warns
        -----
        InputWarning
            If it does.
        """
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
            simulator = Simulator(self._scenarios[scenario])
            observation = simulator.observe(self._snr_db, self._trial, self._seed)
            self._observed[scenario] = observation, simulator.noise_power(self._snr_db)
        return self._observed[scenario]


def warn_of_fault(label: str, error: Exception) -> None:
    """Warn that the diagnosis of an estimator failed or cannot be shown.

    Parameters
    ----------
    label : str
        Of the estimator.
    error : Exception

    Warns
    -----
    InputWarning
    """
    reason = f"{type(error).__name__}: {error}"
    warnings.warn(f"no map and no spectra of {label}: {reason}", InputWarning, stacklevel=3)


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
        If an estimator of the run is not installed, or its diagnosis fails.
    """
    diagnoses = Diagnoses(results.suite, results.records, results.scenarios, snr_db, trial)
    found = [diagnoses.of(scenario, variant) for variant in diagnoses.variants(scenario)]
    seen, scene = [one for one in found if one is not None], results.scenarios[scenario]
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
