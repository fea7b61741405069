"""The figures of a run."""

from __future__ import annotations

import warnings
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

from isacbench.bench.store.run_store import read_results
from isacbench.bench.studies.imaging_study import (
    MANY_SCENARIOS,
    average_scenarios,
    summarise_scores,
)
from isacbench.bench.suites.suite_kinds import kind_of
from isacbench.errors import InputError, InputWarning
from isacbench.files.checked_files import make_own_folder
from isacbench.files.escaping import counted
from isacbench.metrics.deviation import HAUSDORFF_COLUMNS
from isacbench.model.cloud import PointCloud
from isacbench.model.cloud_files.point_files import POINT_COLUMNS
from isacbench.model.echo import Simulator
from isacbench.plugins.contracts import Diagnoser
from isacbench.plugins.registry import build_estimators_of, canonical_params
from isacbench.report.drawing.style import drawable, file_stems, save, styled
from isacbench.report.figures.cloud_figures import Image, draw_clouds
from isacbench.report.figures.curves import draw_deviations, draw_scores, nearest_values, variant_looks
from isacbench.report.figures.map_figures import draw_map
from isacbench.report.figures.pareto_figures import draw_pareto, draw_stages
from isacbench.report.figures.spectrum_figures import draw_spectra
from isacbench.report.tables.pareto import summarise_points, timed_rows
from isacbench.report.tables.run_tables import batched, mean_of_scenarios

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator, Sequence
    from pathlib import Path

    import pandas as pd
    from matplotlib.figure import Figure

    from isacbench.bench.cells.record import Results
    from isacbench.bench.plan.labels import Variant
    from isacbench.plugins.contracts import Estimator
    from isacbench.report.drawing.style import LineLook
    from isacbench.report.figures.curves import NamedFigure

FOLDER = "figures"
CLOUD_SNRS_DB = -20.0, -5.0, 10.0
DIAGNOSIS_SNR_DB = 10.0
CLOUDS_A_FIGURE = 4
CELL = ["estimator", "params", "snr_db"]
MOST_CLOUDS = 16
"""Most estimators of which clouds, maps and spectra are drawn; of more, those of least mean deviation."""

NOT_RUN = Image(PointCloud.empty(), "not run")
"""Cell of which an interrupted run has no record."""


def draw_run(folder: Path, with_diagnoses: bool = True) -> list[Path]:
    """Draw a stored run: of images scores over SNR, clouds, maps and spectra; of a study its own figures.

    Parameters
    ----------
    folder : Path
        Folder of a run; figures of the same names in its ``figures`` are replaced.
    with_diagnoses : bool
        Whether to draw what `draw_diagnoses` does as well.

    Returns
    -------
    list of Path
        What was written. Of images: ``deviation.png``; for each scenario
        ``curves-*.png`` and ``clouds-*.png``, more than one of these where
        the estimators are many, and of the 16 best alone where they are
        more; where the time counts ``pareto-*.png`` and, where stages were
        timed, ``stages-*.png``; of more than 12 scenarios only ``deviation.png``
        with their mean. Of a population ``ratios.png``, ``scores.png``, ``targets-*.png``
        and ``worst-*.png``. Of another study, for each scenario that it has:
        ``efficiency-*.png``; ``resolution-*.png``; ``maps.png`` and
        ``roc.png``, and ``detection-*.png``; or ``link-*.png`` and
        ``trade-*.png``. Nothing where the run holds no cells.

    Raises
    ------
    InputError
        If the folder does not hold a run.

    Warns
    -----
    InputWarning
        If an estimator of the run is not installed, or its diagnosis fails.
    """
    results = read_results(folder)
    kind = kind_of(results.suite)
    names = [kind.figures, *([kind.diagnoses] if with_diagnoses else [])]
    return _drawn(folder, results, names)


def draw_diagnoses(folder: Path) -> list[Path]:
    """Draw what the estimators of a stored run of images see on their way.

    Parameters
    ----------
    folder : Path
        As for `draw_run`.

    Returns
    -------
    list of Path
        Of the first scenario and trial, for each estimator that is a
        `Diagnoser`, of the 16 best alone where they are more:
        ``rdm-*.png`` and, where it detects anything, ``spectrum-*.png``.

    Raises
    ------
    InputError
        If the folder does not hold a run.

    Warns
    -----
    InputWarning
        If an estimator of the run is not installed, or its diagnosis fails.
    """
    results = read_results(folder)
    return _drawn(folder, results, [kind_of(results.suite).diagnoses])


def _drawn(folder: Path, results: Results, names: Sequence[str]) -> list[Path]:
    """Save the figures that some functions yield, each named as ``module:function``."""
    functions = [resolve_name(name) for name in names if name]
    if results.records.empty or not functions:
        return []
    target = folder / FOLDER
    make_own_folder(target)
    with styled():
        return [save(figure, target / f"{stem}.png") for draw in functions for stem, figure in draw(results)]


def _built(specs: Sequence[str]) -> Iterator[tuple[str, Estimator]]:
    """Estimators of a suite as far as they are installed, by specification of each variant."""
    for spec in specs:
        try:
            yield from build_estimators_of(spec)
        except InputError as error:
            warnings.warn(f"no map and no spectra of {spec}: {error}", InputWarning, stacklevel=3)


def imaging_figures(results: Results) -> Iterator[NamedFigure]:
    """Draw scores over SNR, run time against error where the time counts, and clouds.

    Of more than 12 scenarios only their mean deviation is drawn.

    Parameters
    ----------
    results : Results

    Yields
    ------
    stem : str
        Of the file.
    figure : Figure
    """
    looks = variant_looks(results.records)
    if _is_crowded(results):
        yield "deviation", _mean_deviation(results, looks)
        return
    yield from _curves(results, looks)
    yield from _tradeoffs(results, looks)
    yield from _clouds(results, looks)


def _is_crowded(results: Results) -> bool:
    """Tell whether a run has too many scenarios for figures of each."""
    return results.records["scenario"].nunique() > MANY_SCENARIOS


def _mean_deviation(results: Results, looks: dict[Variant, LineLook]) -> Figure:
    """Deviation over SNR as a mean over scenarios, and a warning that nothing else is drawn."""
    n_scenarios = results.records["scenario"].nunique()
    warnings.warn(
        f"of more than {MANY_SCENARIOS} scenarios only the mean deviation is drawn; isacbench image -s "
        "SCENARIO -e ESTIMATOR --plot draws one",
        InputWarning,
        stacklevel=2,
    )
    return draw_deviations(average_scenarios(results.records), looks, mean_of_scenarios(n_scenarios))


def _tradeoffs(results: Results, looks: dict[Variant, LineLook]) -> Iterator[NamedFigure]:
    """Run time against error of every scenario, where the time counts."""
    rows = timed_rows(results.records)
    if rows.empty:
        return
    points = summarise_points(rows, {name for (name, _), look in looks.items() if look.is_bound})
    for scenario, stem in file_stems(points["scenario"].unique()).items():
        yield f"pareto-{stem}", draw_pareto(points, scenario)
        stages = draw_stages(rows, points, scenario)
        if stages is not None:
            yield f"stages-{stem}", stages


def _curves(results: Results, looks: dict[Variant, LineLook]) -> Iterator[NamedFigure]:
    """Scores over SNR, all scenarios together and each on its own."""
    summary = summarise_scores(results.records)
    yield "deviation", draw_deviations(summary, looks)
    for scenario, stem in file_stems(summary["scenario"].unique()).items():
        radius_m = results.scenarios[scenario].radius_m
        yield f"curves-{stem}", draw_scores(summary, scenario, looks, radius_m)


def _clouds(results: Results, looks: dict[Variant, LineLook]) -> Iterator[NamedFigure]:
    """Clouds of every scenario's first trial, a few estimators a figure."""
    # A run of limits alone still has clouds to show.
    candidates = [variant for variant, look in looks.items() if not look.is_bound] or list(looks)
    for scenario, stem in file_stems(results.records["scenario"].unique()).items():
        records = results.records[results.records["scenario"] == scenario]
        shown = _best(records, candidates)
        title = drawable(scenario)
        if len(shown) < len(candidates):
            title += f", the {len(shown)} of {len(candidates)} estimators with the least mean deviation"
        trial, scene = int(records["trial"].min()), results.scenarios[scenario]
        images, snrs_db = _images(results, scenario, trial), sorted(records["snr_db"].unique())
        pages = batched(shown, CLOUDS_A_FIGURE)
        for number, page in enumerate(pages, start=1):
            rows = {
                snr_db: [images.get((*variant, snr_db), NOT_RUN) for variant in page]
                for snr_db in nearest_values(snrs_db, CLOUD_SNRS_DB)
            }
            columns = [looks[variant].label for variant in page]
            suffix = f"-{number}" if len(pages) > 1 else ""
            heading = f"{title}, trial {trial}"
            figure = draw_clouds(heading, scene.truth, scene.region, columns, rows, scene.radius_m)
            yield f"clouds-{stem}{suffix}", figure


def _best(records: pd.DataFrame, candidates: Sequence[Variant]) -> list[Variant]:
    """Estimators whose clouds are drawn, in the order given."""
    if len(candidates) <= MOST_CLOUDS:
        return list(candidates)
    means = records.groupby(["estimator", "params"], sort=False)["deviation"].mean()
    # What failed throughout has no mean, and comes last.
    best = set(means.reindex(list(candidates)).sort_values(kind="stable").index[:MOST_CLOUDS])
    return [variant for variant in candidates if variant in best]


def _images(results: Results, scenario: str, trial: int) -> dict[Hashable, Image]:
    """Images of one trial of a scenario, by name, parameters and SNR."""
    # Numbers first: they are compared much faster than text, and leave little of it.
    points = results.clouds[results.clouds["trial"] == trial]
    points = points[points["scenario"] == scenario]
    clouds: dict[Hashable, PointCloud] = {
        key: PointCloud.from_array(part[POINT_COLUMNS].to_numpy())
        for key, part in points.groupby(CELL, sort=False, observed=True)
    }
    records = results.records[(results.records["trial"] == trial) & (results.records["scenario"] == scenario)]
    return {
        key: _image(clouds.get(key, PointCloud.empty()), record)
        for key, record in records.set_index(CELL).iterrows()
    }


def _image(cloud: PointCloud, record: pd.Series[Any]) -> Image:
    """Cloud of one cell, and what came of it."""
    if record["status"] == "ok":
        hausdorff_m = record[HAUSDORFF_COLUMNS].sum()
        return Image(cloud, f"{counted(len(cloud), 'point')}, Hausdorff sum {hausdorff_m:.1f} m")
    return Image(cloud, "nothing detected" if record["status"] == "no_detection" else str(record["status"]))


def diagnosis_figures(results: Results) -> Iterator[NamedFigure]:
    """Draw maps and spectra of the estimators that show their work, of the first scenario's first trial.

    Of more than 12 scenarios nothing is drawn.

    Parameters
    ----------
    results : Results

    Yields
    ------
    stem : str
        Of the file.
    figure : Figure
    """
    if _is_crowded(results):
        return
    scenario = results.scenarios[results.records["scenario"].iloc[0]]
    diagnosers = _best_diagnosers(results, scenario.name)
    if not diagnosers:
        return
    (snr_db,) = nearest_values(sorted(results.records["snr_db"].unique()), [DIAGNOSIS_SNR_DB])
    simulator = Simulator(scenario)
    observation = simulator.observe(snr_db, int(results.records["trial"].min()), results.suite.seed)
    for (spec, estimator), stem in zip(diagnosers.items(), file_stems(diagnosers).values(), strict=True):
        try:
            diagnosis = estimator.diagnose(observation)
        except Exception as error:  # a plugin's fault must not cost the other figures
            reason = f"{type(error).__name__}: {error}"
            warnings.warn(f"no map and no spectra of {spec}: {reason}", InputWarning, stacklevel=3)
            continue
        title = drawable(f"{scenario.name}, {spec}, {snr_db:g} dB")
        yield f"rdm-{stem}", draw_map(title, diagnosis, scenario.system, simulator.noise_power(snr_db))
        if diagnosis.spectra:
            yield f"spectrum-{stem}", draw_spectra(title, diagnosis, scenario)


def _best_diagnosers(results: Results, scenario: str) -> dict[str, Diagnoser]:
    """Estimators that show their work, by specification; of many those that image a scenario best."""
    found = {
        spec: (plugin, (plugin.name, canonical_params(plugin)))
        for spec, plugin in _built(results.suite.estimators)
        if isinstance(plugin, Diagnoser)
    }
    records = results.records[results.records["scenario"] == scenario]
    best = set(_best(records, [variant for _, variant in found.values()]))
    return {spec: plugin for spec, (plugin, variant) in found.items() if variant in best}
