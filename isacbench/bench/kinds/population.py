"""The kind ``population``: many scenes of several families, each as it is; the scene is the unit."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple

import numpy as np
import pandas as pd
from pydantic import Field

from isacbench.bench.cells.record import failed
from isacbench.bench.kinds.kind import NO_SCENARIOS, OF_IMAGES, Kind, labels_of, lines_of, number_tables
from isacbench.bench.kinds.lone_targets import measure_lone_scatterers
from isacbench.bench.kinds.objects import object_tables, over_snrs
from isacbench.bench.kinds.ratios import POINT_FAMILIES, hausdorff_ratios
from isacbench.bench.kinds.scenes import (
    ImagedScene,
    build_estimators,
    element_snrs_db,
    require_scatterers,
)
from isacbench.bench.kinds.scores import VARIANT, averaged_columns
from isacbench.bench.plan.labels import find_limits
from isacbench.bench.run_times import time_charts
from isacbench.bench.statistics import MIN_TRIALS, median_interval, median_times, student_band, time_words
from isacbench.bench.suites.suite import Suite
from isacbench.charts import (
    SHARE_LIMITS,
    Axis,
    Chart,
    ChartGroup,
    Column,
    LineStyle,
    Series,
    Table,
    decades,
    line_series,
    linear_limits,
    number_or_blank,
    rows_of,
    with_failures,
)
from isacbench.errors import InputError
from isacbench.files.escaping import counted
from isacbench.files.file_names import file_stems
from isacbench.model.frame import PaperFrame
from isacbench.model.radio_coordinates import gain_db
from isacbench.model.scenes.scene_families import use_of_seed

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

    from isacbench.charts import Line, Variant
    from isacbench.metrics.descriptions import Direction
    from isacbench.model.scene import Scenario

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

TARGETS = ["n_false", "share_clean", "share_resolved", "share_met"]
"""Numbers of a scene of lone scatterers."""


NEAR = 0.2
"""Relative distance to the median estimator within which a baseline comes near it."""

BASELINES = "chance", "empty"
"""References without skill: random points, and none."""

MARK = " †"

LARGEST_RATIO = 100.0
"""Larger ratios are drawn at the edge."""

SPREAD = 0.3
"""Share of a row's height over which the dots of scenes are spread, up and down."""

SYMBOLS = {"in phase": "circle", "carrier": "diamond"}
OPEN_FRAME = "paper"
"""Frame whose dots are open; those of the other one are filled."""


class Score(NamedTuple):
    """Number of a summary: its heading, column, form, and how early a terminal leaves it out."""

    heading: str
    column: str
    form: str = "{:.2f}"
    is_higher_better: bool = False
    optional: int = 0


RATIO = Score("median: ratio", "ratio_median")
HAUSDORFF = Score("Hausdorff [m]", "hausdorff_sum_m_mean")
SCORES = (
    RATIO,
    HAUSDORFF,
    Score("F-score", "f_score_mean", is_higher_better=True),
    Score("objects: F-score", "objects_f_score_mean", is_higher_better=True),
    Score("GOSPA: skill", "gospa_skill_mean", is_higher_better=True, optional=1),
    Score("velocity: error [m/s]", "velocity_error_mps_mean", optional=2),
    Score("precision", "precision_mean", is_higher_better=True, optional=4),
    Score("recall", "recall_mean", is_higher_better=True, optional=3),
)
AIMED = (
    Score("false points: an image", "n_false_mean"),
    Score("images: without any", "share_clean_mean", is_higher_better=True),
    Score("scatterers: resolved", "share_resolved_mean", is_higher_better=True),
    Score("images: all met", "share_met_mean", is_higher_better=True),
)
JUDGED = (*SCORES, Score("deviation", "deviation_mean"), *AIMED)


class Drawn(NamedTuple):
    """Number of a summary over SNR: name of its axis, its column, stem of its interval, and sort of axis."""

    axis: str
    column: str
    stem: str
    scale: str = "share"


RATIO_AXIS = "ratio to the oracle"
DRAWN = (
    Drawn(RATIO_AXIS, "ratio_median", "ratio", "log"),
    Drawn("F-score", "f_score_mean", "f_score"),
    Drawn("objects detected", "objects_detected_mean", "objects_detected"),
    Drawn("velocity error [m/s]", "velocity_error_mps_mean", "velocity_error_mps", "positive"),
    Drawn("precision", "precision_mean", "precision"),
    Drawn("recall", "recall_mean", "recall"),
)
DRAWN_TARGETS = (
    Drawn("false points an image", "n_false_mean", "n_false", "positive"),
    Drawn("images without false points", "share_clean_mean", "share_clean"),
    Drawn("scatterers resolved", "share_resolved_mean", "share_resolved"),
    Drawn("images with all met", "share_met_mean", "share_met"),
)


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

        def moved(match: re.Match[str]) -> str:
            seeds = [int(seed) for seed in match[1].split(":")]
            if any(use_of_seed(seed + shift) != use_of_seed(seed) for seed in seeds):
                raise InputError(
                    f"block {number}: {match[0]} of suite {self.name} becomes {seeds[0] + shift}; allowed "
                    f"are blocks whose seeds stay for {use_of_seed(seeds[0])}"
                )
            return "seed=" + ":".join(str(seed + shift) for seed in seeds)

        scenarios = [re.sub(r"seed=(\d+(?::\d+)?)", moved, text) for text in self.scenarios]
        return self.replace(scenarios=scenarios) if shift else self


class PopulationKind(Kind):
    """Scores of many scenes, by family, frame and phases."""

    name = "population"
    suite = PopulationSuite
    columns: ClassVar[Mapping[str, Any]] = {
        "family": "",
        "frame": "",
        "coherent_phase": False,
        "n_resolvable": 0,
        "n_resolved": 0,
        "n_false": 0,
    }
    better: ClassVar[Mapping[str, Direction]] = {
        "n_resolved": "higher",
        "n_resolvable": "neither",
        "coherent_phase": "neither",
    }
    metrics = OF_IMAGES
    has_images = True

    def scenes(self, suite: PopulationSuite, scenarios: Mapping[str, Scenario]) -> list[ImagedScene]:
        """Plan one scene a scenario: the scenario as it is, labelled with family, frame and phases."""
        entries, metrics = build_estimators(suite), self.metrics_of(suite)
        require_scatterers(scenarios)
        return [
            ImagedScene(
                suite,
                scenario,
                entries,
                element_snrs_db(suite, gain_db(scenario)),
                measure=measure_lone_scatterers if scenario.family in POINT_FAMILIES else None,
                metrics=metrics,
                labels={
                    "family": scenario.family,
                    "frame": "paper" if isinstance(scenario.frame, PaperFrame) else "panel",
                    "coherent_phase": scenario.system.coherent_phase,
                },
            )
            for scenario in scenarios.values()
        ]

    def summary(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Summarise a population, and mark the numbers in which a baseline comes near the estimators.

        Returns
        -------
        DataFrame
            As `summarise_population` returns it, with the further columns ``sees_truth`` and
            ``near_chance``, the names of the marked columns as JSON: the better one of `chance` and `empty`
            is better than, or within 20 % of, the median of the estimators that do not see the truth.
        """
        summary = summarise_population(rows)
        summary = summary.copy().assign(sees_truth=summary["estimator"].isin(find_limits(rows)))
        parts = summary.groupby(PART, sort=False, dropna=False)
        marked = {key: json.dumps(near_chance(part)) for key, part in parts}
        near = pd.Series(marked).rename_axis(PART).rename("near_chance")
        return summary.merge(near.reset_index(), how="left", on=PART)

    def tables(self, rows: pd.DataFrame) -> list[Table]:
        """All scenes, ratios by family and by frame and phases, and lone scatterers.

        As details each family on its own, over all SNRs and at each.
        """
        summary = self.summary(rows)
        labels = _row_labels(labels_of(rows), summary)
        snrs_db = sorted(summary["snr_db"].dropna().unique())
        over = over_snrs(snrs_db)
        # A heading of all tables of scores: times of cells that ran beside others mislead.
        words = "time [ms]" + time_words(rows).removeprefix("median processor time")
        found = [*number_tables(rows), _score_table(_part(summary), labels, f"All scenes, {over}", words)]
        families = [name for name in summary["family"].unique() if name != ALL]
        lone = [name for name in families if _part(summary, name)[f"{TARGETS[0]}_mean"].notna().any()]
        scattered = {name: _part(summary, name) for name in families if name not in lone}
        found += _ratio_table(scattered, labels, f"Median ratio by family, {over}")
        conditions = {
            f"{frame}, {phases}": _part(summary, ALL, frame, phases)
            for frame, phases in product(("panel", "paper"), PHASES.values())
        }
        found += _ratio_table(conditions, labels, f"Median ratio by frame and phases, {over}")
        found += [_target_table(_part(summary, name), labels, f"{name}, {over}") for name in lone]
        found += object_tables(rows, labels)
        for name, snr_db in product((ALL, *families), (math.nan, *snrs_db)):
            part = _part(summary, name, snr_db=snr_db)
            if part.empty:  # the run was interrupted before
                continue
            heading = over if math.isnan(snr_db) else f"{snr_db:g} dB"
            title = f"{'All scenes' if name == ALL else name}, {heading}"
            if (name, heading) != (ALL, over):
                found.append(replace(_score_table(part, labels, title, words), is_detail=True))
            if name in lone and heading != over:
                found.append(replace(_target_table(part, labels, title), is_detail=True))
        return found

    def charts(
        self, rows: pd.DataFrame, scenarios: Mapping[str, Scenario] = NO_SCENARIOS
    ) -> list[ChartGroup]:
        """Ratios of all scenes, scores over SNR by family, targets of lone scatterers, and run times."""
        lines = {
            # Bands are over scenes here, and not over the realisations of a reference.
            variant: line._replace(label=line.label.replace(" ± spread", ""))
            for variant, line in lines_of(rows).items()
        }
        summary = summarise_population(rows)
        by_snr = summary[(summary["frame"] == ALL) & (summary["phases"] == ALL)].dropna(subset="snr_db")
        found = [*ratio_charts(scene_cells(rows), lines), _score_charts(by_snr, lines)]
        lone = by_snr.loc[by_snr["n_false_mean"].notna(), "family"].unique()
        for family, stem in file_stems(lone).items():
            part = by_snr[by_snr["family"] == family]
            charts = [_over_snr(one.axis, one, part, lines) for one in DRAWN_TARGETS]
            title = f"{family}: means over {counted(int(part['n_scenes'].max()), 'scene')}{_bands(part)}"
            found.append(ChartGroup(f"targets-{stem}", title, charts))
        return [*found, *time_charts(rows, lines)]


def ratio_charts(cells: pd.DataFrame, lines: Mapping[Variant, Line]) -> list[ChartGroup]:
    """Ratio of every scene to the oracle, a chart for each SNR and family, a row for each estimator.

    A dot a scene, a bar from quartile to quartile; an estimator that sees the truth is a line at its median.
    """
    keys = ["family", "snr_db", *VARIANT, "scenario", "frame", "phases"]
    scenes = cells.dropna(subset="ratio").groupby(keys, sort=False)["ratio"].mean().reset_index()
    if scenes.empty:
        return []
    scenes["ratio"] = scenes["ratio"].clip(upper=LARGEST_RATIO)
    rows = {variant: line for variant, line in lines.items() if not line.is_reference} or dict(lines)
    families, snrs_db = scenes["family"].unique(), sorted(scenes["snr_db"].unique())
    x = Axis(RATIO_AXIS, log=True, limits=(0.8 * scenes["ratio"].min(), 1.2 * scenes["ratio"].max()))
    y = Axis("", categories=[line.label for line in rows.values()])
    charts = []
    for snr_db, family in product(snrs_db, families):
        part = scenes[(scenes["snr_db"] == snr_db) & (scenes["family"] == family)]
        series = [
            one
            for place, (variant, line) in enumerate(rows.items())
            for one in _strip(rows_of(part, variant), place, line)
        ]
        for variant in lines.keys() - rows.keys():
            middle = rows_of(part, variant)["ratio"].median()
            ends = [-0.5, len(rows) - 0.5]
            series.append(Series(lines[variant].label, 2 * [middle], ends, style=lines[variant].style))
        charts.append(Chart(f"{family}, {snr_db:g} dB", x, y, series))
    title = (
        "Hausdorff sum of each scene, divided by that of the oracle (0.3 m or more)\n"
        "a dot a scene, a bar from quartile to quartile, its cross at the median"
    )
    panel_in = 2.1, 0.75 + 0.28 * len(rows)
    return [ChartGroup("ratios", title, charts, n_columns=len(families), panel_in=panel_in)]


def _strip(part: pd.DataFrame, place: int, line: Line) -> Iterable[Series]:
    """Quartiles of an estimator's ratios, and a dot for each of its scenes."""
    if part.empty:
        return
    low, middle, high = part["ratio"].quantile([0.25, 0.5, 0.75]).tolist()
    # Neighbours in ratio at different heights, the same in every run.
    heights = place + SPREAD * (np.arange(len(part)) * 0.618 % 1 * 2 - 1)
    ordered = part.sort_values("ratio", kind="stable").assign(height=heights)
    for (frame, phases), dots in ordered.groupby(["frame", "phases"]):
        symbol = SYMBOLS[str(phases)] + ("-open" if frame == OPEN_FRAME else "")
        words = "in phase" if phases == "in phase" else f"{phases} phases"
        style = LineStyle(line.style.colour, "", symbol)
        yield Series(f"frame {frame}, {words}", dots["ratio"], dots["height"], mark="points", style=style)
    style = LineStyle("", "", "line-ns")
    yield Series("", [middle], [place], x_low=[low], x_high=[high], mark="points", style=style)


def _score_charts(by_snr: pd.DataFrame, lines: Mapping[Variant, Line]) -> ChartGroup:
    """Scores over SNR, a row of charts for each score, a column for each family."""
    families = list(by_snr["family"].unique())
    drawn = [one for one in DRAWN if one.column in by_snr and by_snr[one.column].notna().any()]
    seeing = {variant[0] for variant, line in lines.items() if line.is_reference}
    charts = []
    for one in drawn:
        limits = None
        if one.scale == "positive":
            limits = linear_limits(by_snr[~by_snr["estimator"].isin(seeing)], one.column, one.stem)
        for family in families:
            title = "all scenes" if family == ALL else str(family)
            part = by_snr[by_snr["family"] == family]
            charts.append(_over_snr(title, one, part, lines, limits))
    title = f"Means, and medians of the ratio, over scenes{_bands(by_snr)}"
    return ChartGroup("scores", title, charts, n_columns=len(families), panel_in=(2.1, 1.85))


def _over_snr(
    title: str,
    one: Drawn,
    part: pd.DataFrame,
    lines: Mapping[Variant, Line],
    limits: tuple[float, float] | None = None,
) -> Chart:
    """One number of a part over SNR."""
    series = (
        line_series(part, lines, "snr_db", one.column, one.stem) if part[one.column].notna().any() else []
    )
    if one.scale == "share":
        limits = SHARE_LIMITS
    elif one.scale == "positive" and limits is None:
        limits = linear_limits(part, one.column, one.stem)
    elif one.scale == "log":
        limits = decades(part[one.column])
    return Chart(title, Axis("SNR [dB]"), Axis(one.axis, log=one.scale == "log", limits=limits), series)


def _bands(part: pd.DataFrame) -> str:
    """Say that there are bands, if there are."""
    return ", 95 % confidence bands" if part["recall_band"].notna().any() else ""


def _part(
    summary: pd.DataFrame,
    family: str = ALL,
    frame: str = ALL,
    phases: str = ALL,
    snr_db: float = math.nan,
) -> pd.DataFrame:
    """Rows of some scenes at one SNR, or over all SNRs."""
    is_snr = summary["snr_db"].isna() if math.isnan(snr_db) else summary["snr_db"] == snr_db
    chosen = (summary["family"] == family) & (summary["frame"] == frame) & (summary["phases"] == phases)
    return summary[is_snr & chosen]


def _row_labels(labels: Mapping[Variant, str], summary: pd.DataFrame) -> dict[Variant, str]:
    """Labels of the estimators, then of the references that see the truth."""
    references = set(summary.loc[summary["sees_truth"], "estimator"])
    ordered = sorted(labels, key=lambda variant: variant[0] in references)
    return {one: f"{labels[one]} (ref.)" if one[0] in references else labels[one] for one in ordered}


def _entries(part: pd.DataFrame, labels: Mapping[Variant, str]) -> list[dict[Any, Any]]:
    """Rows of a part with their labels, in the order of the labels."""
    found = {(entry["estimator"], entry["params"]): entry for entry in part.to_dict("records")}
    return [{**found[variant], "label": label} for variant, label in labels.items() if variant in found]


def _score_table(part: pd.DataFrame, labels: Mapping[Variant, str], title: str, words: str) -> Table:
    """Scores of some scenes, a row an estimator."""
    # Where all cells failed, an empty column has their number.
    shown = [one for one in SCORES if one.column in part and part[one.column].notna().any()] or [HAUSDORFF]
    columns = [
        Column("estimator", "label", part=0),
        *_score_columns(shown, part, with_failed=True),
        Column(words, "time_estimate_s_median", "{:.1f}", scale=1e3),
    ]
    return Table(_titled(part, title, columns), columns, _entries(part, labels))


def _target_table(part: pd.DataFrame, labels: Mapping[Variant, str], title: str) -> Table:
    """Absolute targets of lone scatterers, a row an estimator."""
    columns = [Column("estimator", "label", part=0), *_score_columns(AIMED, part)]
    return Table(_titled(part, f"Targets of {title}", columns), columns, _entries(part, labels))


def _score_columns(shown: Iterable[Score], part: pd.DataFrame, with_failed: bool = False) -> list[Column]:
    """Columns of scores, marked where chance comes near; the first one can count failed cells."""
    marked = _marked(part)
    return [
        Column(
            one.heading + _mark(one, marked),
            form=partial(_number, one, with_failed and not place),
            optional=one.optional,
        )
        for place, one in enumerate(shown)
    ]


def _ratio_table(parts: dict[str, pd.DataFrame], labels: Mapping[Variant, str], title: str) -> list[Table]:
    """Median ratios with quartiles, a column for each of some parts; nothing where there are none."""
    shown = {name: part for name, part in parts.items() if part["ratio_median"].notna().any()}
    if len(shown) < 2:
        return []
    entries = {
        name: {(entry["estimator"], entry["params"]): entry for entry in part.to_dict("records")}
        for name, part in shown.items()
    }
    columns = [
        Column("estimator", "label", part=0),
        *(
            Column(f"{name}{_mark(RATIO, _marked(part))}", name, _ratio, part=number)
            for number, (name, part) in enumerate(shown.items(), start=1)
        ),
    ]
    rows: list[dict[str, Any]] = [
        {"label": label, **{name: own.get(variant) for name, own in entries.items()}}
        for variant, label in labels.items()
    ]
    return [Table(_noted(f"{title} (quartiles)", columns), columns, rows)]


def _titled(part: pd.DataFrame, title: str, columns: Iterable[Column]) -> str:
    """Title with the number of scenes, which decides whether there are bands."""
    n_scenes = int(part["n_scenes"].max())
    band = "95 % confidence band" if n_scenes >= MIN_TRIALS else f"no confidence band below {MIN_TRIALS}"
    return _noted(f"{title}: {counted(n_scenes, 'scene')}, {band}", columns)


def _noted(title: str, columns: Iterable[Column]) -> str:
    """Title that explains the mark where a heading has it."""
    is_marked = any(column.heading.endswith(MARK) for column in columns)
    return f"{title}; †: chance or no point at all comes near" if is_marked else title


def _marked(part: pd.DataFrame) -> Collection[str]:
    """Columns in which chance comes near; the same for all rows of a part."""
    marked: list[str] = json.loads(part["near_chance"].iloc[0]) if len(part) else []
    return marked


def _mark(one: Score, marked: Collection[str]) -> str:
    return MARK if one.column in marked else ""


def _number(one: Score, with_failed: bool, entry: Mapping[Any, Any]) -> str:
    """Number of one estimator, a mean with its band."""
    text, stem = number_or_blank(entry[one.column], one.form), one.column.removesuffix("_mean")
    if stem != one.column:
        text += number_or_blank(entry[f"{stem}_band"], f" ±{one.form}")
    return with_failures(text, int(entry["n_failed"])) if with_failed else text


def _ratio(entry: Mapping[Any, Any]) -> str:
    """Median ratio and its quartiles."""
    middle, low, high = (number_or_blank(entry[f"ratio_{end}"], "{:.2f}") for end in ("median", "q25", "q75"))
    return f"{middle} ({low}-{high})" if middle else ""


def near_chance(part: pd.DataFrame) -> list[str]:
    """Find the numbers in which the better one of the baselines comes near the estimators of some scenes.

    Of rows of the summary with ``sees_truth``, one an estimator; its columns are returned.
    """
    judged = [one for one in JUDGED if one.column in part]
    columns = [one.column for one in judged]
    is_baseline = part["estimator"].isin(BASELINES)
    typical = part.loc[~is_baseline & ~part["sees_truth"], columns].median().to_numpy()
    higher = np.array([one.is_higher_better for one in judged])
    found = part.loc[is_baseline, columns]
    guessed = np.where(higher, found.max().to_numpy(), found.min().to_numpy())
    # Without either number nothing is near.
    is_near = np.where(higher, guessed >= (1 - NEAR) * typical, guessed <= (1 + NEAR) * typical)
    return [column for column, near in zip(columns, is_near, strict=True) if near]


def summarise_population(rows: pd.DataFrame) -> pd.DataFrame:
    """Summarise scenes by family, frame, phases and SNR, and over all of each.

    Scores are averaged within a scene first; failed cells have none. Medians, means and intervals
    are over scenes.

    Returns
    -------
    DataFrame
        One row for each ``family``, ``frame``, ``phases`` (``"in phase"`` or ``"carrier"``),
        ``snr_db`` and estimator with its parameters. ``"all"``, and an SNR of NaN, stand for a
        row over all; hand-made scenes have the family ``"hand-made"``. Columns: the counts
        ``n_scenes``, ``n_cells``, ``n_no_detection`` and ``n_failed``; of the ratio to the oracle
        (none for families of lone scatterers) and of ``velocity_nmse`` ``..._median`` with its
        95 % interval ``..._low``, ``..._high``, and the quartiles ``..._q25`` and ``..._q75``; of
        other scores ``..._mean`` and ``..._band``, half its 95 % interval (Student's t), from five
        scenes on; of families of lone scatterers likewise ``n_false``, false points an image,
        ``share_clean``, images without any, ``share_resolved``, resolvable scatterers that were
        resolved, and ``share_met``, images with both targets met; ``time_estimate_s_median``.
    """
    cells = spread_levels(scene_cells(rows))
    by = [*PART, *VARIANT]
    means = [name for name in averaged_columns(rows) if name not in MEDIANS]
    scenes = _scenes(cells, by, [*MEDIANS, *means, *TARGETS])
    groups = scenes.groupby(by, sort=False, dropna=False)
    counts = ["n_cells", "n_no_detection", "n_failed"]
    found = pd.concat([groups.size().rename("n_scenes"), groups[counts].sum()], axis=1)
    columns: dict[str, Any] = {}
    for name in MEDIANS:
        for share in (25, 75):
            columns[f"{name}_q{share}"] = groups[name].quantile(share / 100)
        limits = [median_interval(values.dropna().to_numpy(dtype=np.float64)) for _, values in groups[name]]
        for what, values in zip(("median", "low", "high"), zip(*limits, strict=True), strict=True):
            columns[f"{name}_{what}"] = pd.Series(values, index=found.index)
    for name in [*means, *TARGETS]:
        columns[f"{name}_mean"] = groups[name].mean()
        columns[f"{name}_band"] = student_band(groups[name].std(), groups[name].count())
    found = found.join(pd.DataFrame(columns))
    times = cells.assign(snr_db=cells["snr_db"].fillna(np.inf)).pipe(median_times, by).reset_index()
    times["snr_db"] = times["snr_db"].replace(np.inf, np.nan)
    return found.reset_index().merge(times, how="left", on=by)


def scene_cells(rows: pd.DataFrame) -> pd.DataFrame:
    """Add to each row what only a population has: ``phases``, ``ratio``, and the targets of lone scatterers.

    The targets are those that `summarise_population` names, NaN for other families.
    """
    broken, is_lone = failed(rows), rows["family"].isin(POINT_FAMILIES)
    cell = ["scenario", "snr_db", "trial"]
    # Failed cells do not know it.
    n_resolvable = rows.groupby(cell)["n_resolvable"].transform("max")
    is_clean, is_whole = (
        ~broken & (rows["n_false"] == 0),
        ~broken & (rows["n_resolved"] == n_resolvable),
    )
    targets = pd.DataFrame(
        {
            "n_false": rows["n_false"].where(~broken),
            "share_clean": is_clean,
            "share_resolved": (rows["n_resolved"] / n_resolvable).where(n_resolvable > 0),
            "share_met": is_clean & is_whole,
        },
        dtype=np.float64,
    )
    return rows.assign(
        family=rows["family"].replace("", HAND_MADE),
        phases=rows["coherent_phase"].map(PHASES),
        n_estimated=rows["n_estimated"].where(~broken),
        ratio=hausdorff_ratios(rows, rows.loc[is_lone, "scenario"].unique()),
        n_no_detection=rows["status"] == "no_detection",
        n_failed=broken,
        **targets.where(is_lone),
    )


def spread_levels(cells: pd.DataFrame) -> pd.DataFrame:
    """Repeat the rows of `scene_cells` for every level of the summary that they belong to.

    Each eight times: with its own family or ``"all"``, its own frame and phases or ``"all"``, its own SNR
    or NaN. Rows over all families have no targets of lone scatterers.
    """
    together = cells.assign(family=ALL, **dict.fromkeys(TARGETS, np.nan))
    levels = pd.concat([together, cells], ignore_index=True)
    levels = pd.concat([levels.assign(frame=ALL, phases=ALL), levels], ignore_index=True)
    return pd.concat([levels.assign(snr_db=np.nan), levels], ignore_index=True)


def _scenes(cells: pd.DataFrame, by: list[str], scores: list[str]) -> pd.DataFrame:
    """Average the cells of every scene in each group."""
    groups = cells.groupby([*by, "scenario"], sort=False, dropna=False)
    columns: dict[str, Any] = {
        "n_cells": groups.size(),
        "n_no_detection": groups["n_no_detection"].sum(),
        "n_failed": groups["n_failed"].sum(),
    }
    return pd.DataFrame(columns).join(groups[scores].mean()).reset_index()
