"""The kind ``population``: many scenes of several families, each as it is; the scene is the unit.

Scenes of lone scatterers have absolute targets: no false point, and errors that the Cramér-Rao bound
explains. Points and scatterers are matched one to one within a Rayleigh cell. A point without a match is
false: one that is a cell or more from every scatterer in some coordinate, and the second one of a single
scatterer.

A scatterer is resolvable if the joint bound of all scatterers of the scene, which knows neither places nor
amplitudes, is at most a tenth of a Rayleigh cell in each coordinate. Of a scatterer alone it is a tenth at
11.8 dB after all gain. Below that, the noise in one of some million cells is as strong, and no estimator
finds the scatterer without false points.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Annotated, Any, ClassVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import Field
from scipy.optimize import linear_sum_assignment

from isacbench import charts
from isacbench.bench import statistics
from isacbench.bench.cells.images import Image
from isacbench.bench.cells.rows import failed
from isacbench.bench.cells.task import ImagingTask, build_estimators
from isacbench.bench.kinds import kind, scores
from isacbench.bench.kinds.kind import NO_SCENARIOS, OF_IMAGES, Kind, Scenarios
from isacbench.bench.kinds.scores import COUNTS, LONE_COUNTS, POINT_FAMILIES, SCORES, Score, score_chart
from isacbench.bench.labels import references_in
from isacbench.bench.run_times import time_charts
from isacbench.bench.suites.suite import Suite
from isacbench.charts import VARIANT, Axis, Chart, ChartGroup, Column, Line, LineStyle, Series, Table, Variant
from isacbench.checked_arrays import Floats
from isacbench.dsp.bounds import joint_bound
from isacbench.errors import InputError
from isacbench.files.escaping import file_stems
from isacbench.model.echo import echo_parameters
from isacbench.model.frame import PaperFrame
from isacbench.model.radio_coordinates import radio_places, rayleigh_cells
from isacbench.model.scene import Scenario
from isacbench.model.scenes.scene_families import use_of_seed

ALL = "all"
"""Value of `family`, `frame` and `phases` in a row over all of them."""

HAND_MADE = "hand-made"
"""Value of `family` of scenes that no family made."""

PHASES = {False: "in phase", True: "carrier"}
"""Value of `phases` by the column ``coherent_phase``."""

PART = ["family", "frame", "phases", "snr_db"]
"""Columns that say of which scenes and SNRs a row of the summary is."""

MEDIANS = ["ratio", "velocity_nmse"]
"""Numbers of a scene whose distribution has a long tail."""

TARGETS = {
    "n_false": Score("false points: an image"),
    "share_clean": Score("images: without false points", "share", is_higher_better=True),
    "share_resolved": Score("scatterers: resolved", "share", is_higher_better=True),
    "share_met": Score("images: all met", "share", is_higher_better=True),
}
"""Numbers of a scene of lone scatterers."""

OWN_SCORES = {**SCORES, "ratio": Score("median ratio: to the oracle", "log"), **TARGETS}
IN_TABLES = (
    *("ratio", "hausdorff_sum_m", "f_score", "objects_f_score", "gospa_skill", "velocity_error_mps"),
    *("precision", "recall", *TARGETS),
)
IN_CHARTS = "ratio", "f_score", "objects_detected", "velocity_error_mps", "precision", "recall"

RESOLVABLE_CELLS = 0.1
"""Largest bound of a resolvable scatterer, a standard deviation, in Rayleigh cells."""

MOST_DEVIATIONS = 3.0
"""Largest error of a resolved scatterer in standard deviations of the bound."""

NEAR = 0.2
"""Relative distance to the median estimator within which a baseline comes near it."""

BASELINES = "chance", "empty"
"""References without skill: random points, and none."""

MARK = " †"
NOTE = "; †: chance or no point at all comes near"

LARGEST_RATIO = 100.0
"""Larger ratios are drawn at the edge."""

SPREAD = 0.3
"""Share of a row's height over which the dots of scenes are spread, up and down."""


class PopulationSuite(Suite):
    """Suite of the kind ``population``.

    Attributes
    ----------
    version : int
        Version of the population, which says which scenes it has. Runs of different versions are not
        merged.
    block_seeds : int or None
        Seeds of its scenes, which follow each other: another block has the next ones.
    """

    kind: str = "population"
    version: Annotated[int, Field(ge=1)]
    block_seeds: Annotated[int, Field(ge=1)] | None = None

    def in_block(self, number: int) -> PopulationSuite:
        """Shift the seeds of all scenes by a number of blocks.

        An `InputError` where it has no blocks, or seeds would be for something else: below 500 for
        developing, to 999 for validating, from 1000 for reporting.
        """
        if self.block_seeds is None:
            raise InputError(f"suite {self.name} has no blocks: it lacks the key block_seeds")
        shift = number * self.block_seeds

        def shifted(match: re.Match[str]) -> str:
            seeds = [int(seed) for seed in match[1].split(":")]
            if any(use_of_seed(seed + shift) != use_of_seed(seed) for seed in seeds):
                raise InputError(
                    f"block {number}: {match[0]} of suite {self.name} becomes {seeds[0] + shift}; allowed "
                    f"are blocks whose seeds stay for {use_of_seed(seeds[0])}"
                )
            return "seed=" + ":".join(str(seed + shift) for seed in seeds)

        scenarios = [re.sub(r"seed=(\d+(?::\d+)?)", shifted, text) for text in self.scenarios]
        return self.replace(scenarios=scenarios) if shift else self


class PopulationKind(Kind):
    """Scores of many scenes, by family, frame and phases."""

    name = "population"
    suite = PopulationSuite
    columns: ClassVar = {"family": "", "frame": "", "coherent_phase": False, **dict.fromkeys(LONE_COUNTS, 0)}
    better: ClassVar = {"n_resolved": "higher", "n_resolvable": "neither", "coherent_phase": "neither"}
    metrics = OF_IMAGES
    has_scenes = True
    has_images = True

    def tasks(self, suite: PopulationSuite, scenarios: Scenarios) -> list[ImagingTask]:
        """Plan one task a scenario: the scenario as it is, labelled with family, frame and phases."""
        entries, metrics, tasks = build_estimators(suite), self.metrics_of(suite), []
        for one in scenarios.values():
            measure = measure_lone_scatterers if one.family in POINT_FAMILIES else None
            frame = "paper" if isinstance(one.frame, PaperFrame) else "panel"
            labels = {"family": one.family, "frame": frame, "coherent_phase": one.system.coherent_phase}
            tasks.append(ImagingTask(suite, one, entries, measure=measure, metrics=metrics, labels=labels))
        return tasks

    def summary(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Summarise a population, and mark the numbers in which a baseline comes near the estimators.

        As `summarise_population`, with the further columns ``sees_truth`` and ``near_chance``, the names of
        the marked columns as JSON.
        """
        summary = summarise_population(rows)
        summary["sees_truth"] = summary["estimator"].isin(references_in(rows))
        for _, part in summary.groupby(PART, sort=False, dropna=False):
            summary.loc[part.index, "near_chance"] = json.dumps(near_chance(part))
        return summary

    def tables(self, rows: pd.DataFrame) -> list[Table]:
        """All scenes, families of lone scatterers, ratios by family and by frame and phases, and objects.

        As details each family on its own, over all SNRs and at each.
        """
        summary, labels, tables = self.summary(rows), kind.labels_of(rows), kind.number_tables(rows)
        references = references_in(rows)
        ordered = sorted(labels, key=lambda variant: variant[0] in references)
        labels = scores.with_references({one: labels[one] for one in ordered}, references)
        over, is_of_all_frames = scores.over_snrs(rows), summary["frame"] == ALL
        # A heading of all tables: times of cells that ran beside others mislead.
        words = "time [ms]" + statistics.time_words(rows).removeprefix("median processor time")
        by = summary[is_of_all_frames].groupby(["family", "snr_db"], sort=False, dropna=False)
        for key, part in by:
            family, snr_db = map(str, key)
            is_over_all = snr_db == "nan"
            is_detail = not is_over_all or bool(family != ALL and part["n_false_mean"].isna().all())
            snrs = over if is_over_all else f"{float(snr_db):g} dB"
            title = f"{'All scenes' if family == ALL else family}, {snrs}"
            tables.append(replace(_score_table(part, labels, title, words), is_detail=is_detail))
        ratios = summary[summary["snr_db"].isna()].dropna(subset="ratio_median")
        own = ratios[(ratios["frame"] == ALL) & (ratios["family"] != ALL)]
        tables += _ratio_table(own, ["family"], labels, f"Median ratio by family, {over}")
        own = ratios[(ratios["frame"] != ALL) & (ratios["family"] == ALL)]
        tables += _ratio_table(own, ["frame", "phases"], labels, f"Median ratio by frame and phases, {over}")
        return sorted(tables + scores.object_tables(rows, labels), key=lambda table: table.is_detail)

    def charts(self, rows: pd.DataFrame, scenarios: Scenarios = NO_SCENARIOS) -> list[ChartGroup]:
        """Ratios of all scenes, scores over SNR by family, targets of lone scatterers, and run times."""
        lines = kind.lines_of(rows)
        summary = summarise_population(rows)
        by_snr = summary[summary["frame"] == ALL].dropna(subset="snr_db")
        groups = [*ratio_charts(with_ratios(rows), lines), _score_charts(by_snr, lines)]
        lone = by_snr[by_snr["n_false_mean"].notna()]
        stems = file_stems(lone["family"].unique())
        for family, part in lone.groupby("family", sort=False):
            panels = [
                score_chart(one.name, one, f"{name}_mean", part, lines, part) for name, one in TARGETS.items()
            ]
            title = f"{family}: means over {statistics.trials_and_band(part['n_scenes'].max(), 'scene')}"
            groups.append(ChartGroup(f"targets-{stems[str(family)]}", title, panels))
        return [*groups, *time_charts(rows, lines)]


def ratio_charts(cells: pd.DataFrame, lines: Mapping[Variant, Line]) -> list[ChartGroup]:
    """Ratio of every scene to the oracle, a chart for each SNR and family, a row for each estimator.

    A dot a scene, a bar from quartile to quartile; an estimator that sees the truth is a line at its median.
    """
    keys = ["family", "snr_db", *VARIANT, "scenario"]
    scenes = cells.dropna(subset="ratio").groupby(keys, sort=False)["ratio"].mean().reset_index()
    if scenes.empty:
        return []
    scenes["ratio"] = scenes["ratio"].clip(upper=LARGEST_RATIO)
    places = {variant: line for variant, line in lines.items() if not line.is_reference} or dict(lines)
    families = scenes["family"].unique()
    limits = 0.8 * scenes["ratio"].min(), 1.2 * scenes["ratio"].max()
    x = Axis("ratio to the oracle", log=True, limits=limits)
    y = Axis("", categories=[line.label for line in places.values()])
    panels = []
    for snr_db, family in product(sorted(scenes["snr_db"].unique()), families):
        part = scenes[(scenes["snr_db"] == snr_db) & (scenes["family"] == family)]
        series: list[Series] = []
        for variant, line in lines.items():
            ratios = charts.rows_of(part, variant)["ratio"]
            if variant in places:
                series += _strip(ratios, list(places).index(variant), line)
            else:
                ends = [-0.5, len(places) - 0.5]
                series.append(Series(line.label, 2 * [ratios.median()], ends, style=line.style))
        panels.append(Chart(f"{family}, {snr_db:g} dB", x, y, series))
    title = (
        "Hausdorff sum of each scene, divided by that of the oracle (0.3 m or more)\n"
        "a dot a scene, a bar from quartile to quartile, its tick at the median"
    )
    panel_in = 2.1, 0.75 + 0.28 * len(places)
    return [ChartGroup("ratios", title, panels, n_columns=len(families), panel_in=panel_in)]


def _strip(ratios: pd.Series[float], place: int, line: Line) -> list[Series]:
    """Quartiles of an estimator's ratios, and a dot for each of its scenes."""
    low, middle, high = ratios.quantile([0.25, 0.5, 0.75])
    # Neighbours in ratio at different heights, the same in every run.
    heights = place + SPREAD * (np.arange(len(ratios)) * 0.618 % 1 * 2 - 1)
    dots, bar = LineStyle(line.style.colour, "", "circle"), LineStyle("", "", "line-ns")
    return [
        Series("", ratios.sort_values(kind="stable"), heights, mark="points", style=dots),
        Series("", [middle], [place], x_low=[low], x_high=[high], mark="points", style=bar),
    ]


def _score_charts(by_snr: pd.DataFrame, lines: Mapping[Variant, Line]) -> ChartGroup:
    """Scores over SNR, a row of charts for each score, a column for each family."""
    references = {variant[0] for variant, line in lines.items() if line.is_reference}
    compared, panels = by_snr[~by_snr["estimator"].isin(references)], []
    for name in IN_CHARTS:
        column = _column(name)
        if column not in by_snr or by_snr[column].isna().all():
            continue
        for family, part in by_snr.groupby("family", sort=False):
            title, own = "all scenes" if family == ALL else str(family), part.dropna(subset=column)
            panels.append(
                score_chart(title, OWN_SCORES[name], column, part, lines if len(own) else {}, compared)
            )
    n_scenes = statistics.trials_and_band(by_snr["n_scenes"].max(), "scene")
    title = f"Means, and medians of the ratio, over scenes: {n_scenes}"
    n_columns = by_snr["family"].nunique()
    return ChartGroup("scores", title, panels, n_columns, panel_in=(2.1, 1.85))


def _score_table(part: pd.DataFrame, labels: Mapping[Variant, str], title: str, words: str) -> Table:
    """Scores of some scenes, a row an estimator, with the number of scenes, which decides about bands."""
    columns, marked = [Column("estimator", "label", part=0)], json.loads(part["near_chance"].iloc[0])
    for name in IN_TABLES:
        one, column = OWN_SCORES[name], _column(name)
        if column in part and part[column].notna().any():
            heading = one.name + MARK if column in marked else one.name
            columns.append(Column(heading, form=partial(scores.mean_text, column), optional=one.optional))
    if part["n_failed"].any():
        columns.append(Column("failed: cells", "n_failed"))
    columns.append(Column(words, "time_estimate_s_median", "{:.1f}", scale=1e3))
    title += f": {statistics.trials_and_band(part['n_scenes'].max(), 'scene')}{NOTE if marked else ''}"
    return Table(title, columns, scores.labelled_rows(part.to_dict("records"), labels))


def _ratio_table(
    ratios: pd.DataFrame, by: list[str], labels: Mapping[Variant, str], title: str
) -> list[Table]:
    """Median ratios with quartiles, a column for each of some parts; nothing where there is but one."""
    columns = [Column("estimator", "label", part=0)]
    for place, (key, part) in enumerate(ratios.groupby(by, sort=False), start=1):
        mark = MARK if _column("ratio") in json.loads(part["near_chance"].iloc[0]) else ""
        columns.append(Column(", ".join(map(str, key)) + mark, key, _ratio_text, part=place))
    rows = scores.labelled_rows(charts.spread_rows(ratios, VARIANT, by), labels)
    return [Table(f"{title} (quartiles){NOTE}", columns, rows)] if len(columns) > 2 else []


def _column(name: str) -> str:
    """Column of a summary with the mean or the median of a number."""
    return f"{name}_{'median' if name in MEDIANS else 'mean'}"


def _ratio_text(entry: Mapping[Any, Any]) -> str:
    """Median ratio and its quartiles."""
    return f"{entry['ratio_median']:.2f} ({entry['ratio_q25']:.2f}-{entry['ratio_q75']:.2f})"


def near_chance(part: pd.DataFrame) -> list[str]:
    """List the columns in which a baseline comes near the estimators, in rows of the same scenes.

    The better one of `chance` and `empty` is better than, or within 20 % of, the median of the estimators
    that do not see the truth. Without either number nothing is near.
    """
    compared = {_column(name): OWN_SCORES[name].is_higher_better for name in (*IN_TABLES, "deviation")}
    is_higher = pd.Series(compared).loc[[column for column in compared if column in part]]
    columns, is_baseline = list(is_higher.index), part["estimator"].isin(BASELINES)
    typical = part.loc[~is_baseline & ~part["sees_truth"], columns].median()
    guesses = part.loc[is_baseline, columns]
    is_near_high = guesses.max() >= (1 - NEAR) * typical
    is_near_low = guesses.min() <= (1 + NEAR) * typical
    return list(is_higher.index[np.where(is_higher, is_near_high, is_near_low)])


def summarise_population(rows: pd.DataFrame) -> pd.DataFrame:
    """Summarise scenes by family, frame, phases and SNR, and over all of each.

    Scores are averaged within a scene first; failed cells have none. Medians, means and intervals
    are over scenes.

    One row for each ``family``, ``frame``, ``phases`` (``"in phase"`` or ``"carrier"``), ``snr_db`` and
    estimator. ``"all"``, and an SNR of NaN, stand for a row over all; hand-made scenes have the family
    ``"hand-made"``. Columns: the counts ``n_scenes``, ``n_cells``, ``n_no_detection`` and ``n_failed``; of
    the ratio to the oracle (none for families of lone scatterers) and of ``velocity_nmse`` ``..._median``
    with its 95 % interval ``..._low``, ``..._high``, and the quartiles ``..._q25`` and ``..._q75``; of other
    scores ``..._mean`` and ``..._band``, half its 95 % interval (Student's t), from five scenes on; of
    families of lone scatterers likewise ``n_false``, false points an image, ``share_clean``, images without
    any, ``share_resolved``, resolvable scatterers that were resolved, and ``share_met``, images with both
    targets met; ``time_estimate_s_median``.
    """
    cells = with_totals(with_ratios(rows))
    by = [*PART, *VARIANT]
    means = [*(name for name in scores.averaged_columns(rows) if name not in MEDIANS), *TARGETS]
    groups = scores.grouped_scenarios(cells, by, [*MEDIANS, *means])
    summary = groups[COUNTS].sum()
    summary.insert(0, "n_scenes", groups.size())
    for name in MEDIANS:
        for share in (25, 75):
            summary[f"{name}_q{share}"] = groups[name].quantile(share / 100)
        numbers = (values.to_numpy() for _, values in groups[name])
        limits = [statistics.median_interval(each[~np.isnan(each)]) for each in numbers]
        summary[[f"{name}_{end}" for end in ("median", "low", "high")]] = limits
    summary = summary.join(statistics.means_and_bands(groups, means)).reset_index()
    return summary.merge(statistics.median_times(cells, by).reset_index(), how="left", on=by)


def with_ratios(rows: pd.DataFrame) -> pd.DataFrame:
    """Add to each row what only a population has: ``phases``, ``ratio``, and the targets of lone scatterers.

    The targets are those that `summarise_population` names, NaN for other families.
    """
    broken, is_lone = failed(rows), rows["family"].isin(POINT_FAMILIES)
    # Failed cells do not know it.
    n_resolvable = rows.groupby(["scenario", "snr_db", "trial"])["n_resolvable"].transform("max")
    is_clean = ~broken & (rows["n_false"] == 0)
    targets = {
        "n_false": rows["n_false"].where(~broken),
        "share_clean": is_clean,
        "share_resolved": (rows["n_resolved"] / n_resolvable).where(n_resolvable > 0),
        "share_met": is_clean & (rows["n_resolved"] == n_resolvable),
    }
    return scores.with_counts(rows).assign(
        family=rows["family"].replace("", HAND_MADE),
        phases=rows["coherent_phase"].map(PHASES),
        ratio=scores.hausdorff_ratios(rows, rows.loc[is_lone, "scenario"].unique()),
        **pd.DataFrame(targets, dtype=np.float64).where(is_lone),
    )


def with_totals(cells: pd.DataFrame) -> pd.DataFrame:
    """Repeat the rows of `with_ratios` for every level of the summary that they belong to.

    Each eight times: with its own family or ``"all"``, its own frame and phases or ``"all"``, its own SNR
    or NaN. Rows over all families have no targets of lone scatterers.
    """
    together = cells.assign(family=ALL, **dict.fromkeys(TARGETS, np.nan))
    levels = pd.concat([together, cells], ignore_index=True)
    levels = pd.concat([levels.assign(frame=ALL, phases=ALL), levels], ignore_index=True)
    return pd.concat([levels.assign(snr_db=np.nan), levels], ignore_index=True)


def measure_lone_scatterers(image: Image) -> dict[str, Any]:
    """Count the resolvable scatterers of an image, those of them that are resolved, and its false points.

    One is resolved by a point within 3 standard deviations of the bound in range, velocity, u and w.
    """
    scenario = image.scenario
    bound, cells = scene_bound(scenario, image.snr_db), rayleigh_cells(scenario)
    is_resolvable = np.all(bound <= RESOLVABLE_CELLS * cells, axis=1)
    error = radio_places(scenario, image.cloud)[:, None] - radio_places(scenario, scenario.scatterers)
    points, scatterers = match_points(error / cells)
    is_exact = np.all(np.abs(error[points, scatterers]) <= MOST_DEVIATIONS * bound[scatterers], axis=1)
    return {
        "n_resolvable": int(is_resolvable.sum()),
        "n_resolved": int((is_exact & is_resolvable[scatterers]).sum()),
        "n_false": len(image.cloud) - len(points),
    }


def scene_bound(scenario: Scenario, snr_db: float) -> Floats:
    """Cramér-Rao bound of all scatterers of a scene together, without errors of the array.

    Standard deviations (n, 4) of range in m, velocity in m/s, u and w; infinite where scatterers cannot be
    resolved. Their amplitudes must not be 0. The SNR is that per resource element and virtual element.
    """
    gain = echo_parameters(scenario).gain
    noise_power = float(np.sum(np.abs(gain) ** 2)) / 10 ** (snr_db / 10) * scenario.array.n_turns
    range_m, velocity_mps, u, w = radio_places(scenario, scenario.scatterers).T
    bound = joint_bound(scenario.system, scenario.array.shape, range_m, velocity_mps, u, w, gain, noise_power)
    return np.stack([bound.range_m, bound.velocity_mps, bound.u, bound.w], axis=1)


def match_points(error_cells: Floats) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Match points and scatterers one to one: as many as possible, then at the least sum of distances.

    Takes differences (n_points, n_scatterers, 4) of their coordinates in Rayleigh cells, and returns the
    indices of the pairs, points and scatterers. A pair is possible if all differences are below 1.
    """
    is_possible: NDArray[np.bool_] = np.asarray(np.all(np.abs(error_cells) < 1, axis=2))
    distance = np.linalg.norm(error_cells, axis=2)
    # A possible pair is at most 2 cells long: no sum of them is worth an impossible one.
    impossible = 2.0 * (1 + min(is_possible.shape))
    points, scatterers = linear_sum_assignment(np.where(is_possible, distance, impossible))
    is_pair = is_possible[points, scatterers]
    return points[is_pair], scatterers[is_pair]
