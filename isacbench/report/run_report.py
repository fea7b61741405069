"""The report of a run: its tables, its figures, chosen figures for papers, and its page."""

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from isacbench import charts
from isacbench.bench.cells.rows import CLOUD_KEYS, failed
from isacbench.bench.kinds.imaging import score_charts
from isacbench.bench.kinds.kind import lines_of, title_stems
from isacbench.bench.kinds.population import with_ratios
from isacbench.bench.kinds.scores import MANY_SCENARIOS, SCORES, averaged_columns, summarise_scores
from isacbench.bench.labels import estimator_labels
from isacbench.bench.run_times import is_timed, stage_tables, summarise_points, summarise_stages, timed_rows
from isacbench.bench.store.manifest import command_to_show
from isacbench.bench.store.run import CellKey, Run
from isacbench.bench.store.run_folder import atomic_write, without_formulas
from isacbench.bench.suites.suite_kinds import KINDS
from isacbench.charts import Axis, Chart, ChartGroup, Column, Line, Series, Table, Variant
from isacbench.errors import InputError, InputWarning, unknown_name
from isacbench.files.escaping import file_stems, plural, shortened
from isacbench.metrics.geometry import CloudPair
from isacbench.metrics.one_to_one import Curve, score_curve
from isacbench.metrics.paper import PROJECTIONS
from isacbench.model.cloud import PointCloud
from isacbench.report.clouds import (
    Image,
    best_variants,
    draw_clouds,
    draw_comparison,
    image_of_truth,
    shown_snr_db,
)
from isacbench.report.diagnoses import diagnosis_figures
from isacbench.report.drawing import DrawingProcess
from isacbench.report.figures import FOLDER, Drawing, drawable, drawings_of, save_figures
from isacbench.report.html.written_pages import write_run_page
from isacbench.report.tables import markdown

MOST_FAILURES = 20
CLOUD_SNRS_DB = -20.0, -5.0, 10.0
CLOUDS_A_FIGURE = 4
MOST_WORST = 6
"""Most estimators whose worst scene is drawn."""

NOT_RUN = Image(PointCloud.empty(), "not run")
"""Cell of which an interrupted run has no row."""


class FigureChoice(NamedTuple):
    """Choice of figures of a run; None leaves it open.

    Attributes
    ----------
    metric : str or None
        Score over SNR. Without it scores are drawn only if neither SNR nor trial is chosen.
    """

    scenario: str | None = None
    snr_db: float | None = None
    trial: int | None = None
    metric: str | None = None


EVERYTHING = FigureChoice()
RUN_REPORTS = "summary.csv", "summary.md", "stages.csv", "stages.md", "pareto.csv"


def write_report(
    run: Run, with_page: bool = True, helper: DrawingProcess | None = None
) -> tuple[list[Path], list[Table]]:
    """Write tables, figures and page of a run into its folder; return the files and the tables."""
    written, tables = write_run_tables(run)
    return [*written, *draw_with_page(run, with_page, helper)], tables


def draw_with_page(run: Run, with_page: bool = True, helper: DrawingProcess | None = None) -> list[Path]:
    """Draw a run and write its page; warn where there can be none, for the figures are there all the same."""
    written = draw_run(run, helper=helper)
    if with_page and not run.rows.empty:
        try:
            written.append(write_run_page(run))
        except InputError as error:
            warnings.warn(f"no page: {error}", InputWarning, stacklevel=2)
    return written


def write_run_tables(run: Run) -> tuple[list[Path], list[Table]]:
    """Write ``summary.csv`` and ``summary.md`` into the folder of a run, and the tables of its times.

    ``summary.md`` ends with the reasons of failed cells, if there are any, and commands that repeat them.
    Of timed rows also ``stages.csv``, ``stages.md``, and of images ``pareto.csv``. Tables of these names are
    replaced; those that are empty now are removed. Returned are the files, and the tables but that of
    failures.
    """
    rows, kind = run.rows, KINDS[run.kind]
    tables: list[Table] = []
    stages: list[Table] = []
    files: dict[str, pd.DataFrame | list[Table]] = dict.fromkeys(RUN_REPORTS, tables)
    if not rows.empty:
        tables = kind.tables(rows)
        files["summary.csv"] = kind.summary(rows)
        files["summary.md"] = tables + failure_tables(rows, run.manifest)
        if is_timed(rows):
            stages = stage_tables(rows)
            files |= {"stages.csv": summarise_stages(rows), "stages.md": stages}
            if kind.has_images:
                files["pareto.csv"] = summarise_points(timed_rows(rows))
    for name, content in files.items():
        path = run.folder / name
        if not len(content):
            path.unlink(missing_ok=True)
            continue
        with atomic_write(path) as temporary:
            if isinstance(content, list):
                text = "\n".join(map(markdown, content))
            else:
                text = without_formulas(content).to_csv(index=False)
            temporary.write_text(text, encoding="utf-8", newline="")
    return [run.folder / name for name, content in files.items() if len(content)], tables + stages


def failure_tables(rows: pd.DataFrame, manifest: Mapping[str, Any] | None = None) -> list[Table]:
    """Count the failed cells of a run by reason, estimator and scenario, the most frequent first.

    With its manifest the table has a command for a cell of each row. Of more than twenty rows the last one
    counts what the others leave; long reasons are without their middle.
    """
    broken = rows[failed(rows)]
    if broken.empty:
        return []
    labels = estimator_labels(charts.variants_in(rows))
    place = broken["scenario"]
    if "template" in broken:  # scenes that are made from templates count together
        place = broken["template"].where(broken["template"] != "", place)
    keys = ["reason", "status", "estimator", "params", "place"]
    groups = broken.assign(place=place).groupby(keys, sort=False)
    first = {name: (name, "first") for name in ("scenario", "snr_db", "trial")}
    table = groups.agg(n_cells=("trial", "size"), **first).reset_index()
    counts = table.sort_values("n_cells", ascending=False, kind="stable").to_dict("records")
    for row in counts:
        row["label"] = label = labels[row["estimator"], row["params"]]
        cell = row["scenario"], label, row["snr_db"], row["trial"]
        row["command"] = command_to_show(manifest or {}, *cell)
    listed, rest = counts[:MOST_FAILURES], counts[MOST_FAILURES:]
    if rest:
        n_cells = sum(row["n_cells"] for row in rest)
        listed.append({"reason": f"{len(rest)} further rows", "n_cells": n_cells})
    columns = [
        Column("reason", form=lambda row: shortened(row["reason"])),
        Column("status", "status"),
        Column("estimator", "label"),
        Column("scenario", "place"),
        Column("cells", "n_cells"),
    ]
    if any(row["command"] for row in counts):  # no command repeats the cells of some kinds
        columns.append(Column("the first one again", "command"))
    return [Table(f"{len(broken)} of {len(rows)} cells failed", columns, listed)]


def draw_run(
    run: Run,
    choice: FigureChoice = EVERYTHING,
    extension: str = "png",
    helper: DrawingProcess | None = None,
) -> list[Path]:
    """Draw a run, or chosen figures of it, into ``figures`` of its folder.

    All figures are the charts of its kind, and of images ``radii.png``, and for each scenario
    ``clouds-*.png``, more than one where the estimators are many, and of the 16 best alone where they are
    more; of a population ``worst-*.png``. Of more than 12 scenarios no clouds. Chosen ones are
    ``<metric>-*`` or ``curves-*`` of scores; ``clouds-*``, ``rdm-*`` and ``spectrum-*`` of images, with SNR
    and trial in their names. Nothing where the run holds no cells.
    """
    rows = run.rows if choice == EVERYTHING else _chosen_rows(run, choice)
    if rows.empty:
        return []
    drawings = _all_figures(run) if choice == EVERYTHING else _chosen_figures(run, rows, choice)
    return save_figures(drawings, run.folder / FOLDER, extension, helper)


def _all_figures(run: Run) -> Iterator[Drawing]:
    """All figures of a run by the stems of their files."""
    rows, kind, lines = run.rows, KINDS[run.kind], lines_of(run.rows)
    yield from drawings_of(kind.charts(rows, run.scenarios))
    if not kind.has_images:
        return
    yield from drawings_of(radius_charts(run, lines))
    if kind.name == "population":
        yield from _worst_images(run, lines)
    elif rows["scenario"].nunique() > MANY_SCENARIOS:
        message = f"of more than {MANY_SCENARIOS} scenarios only means are drawn; "
        message += "isacbench image -s SCENARIO -e ESTIMATOR --plot draws one"
        warnings.warn(message, InputWarning, stacklevel=2)
    else:
        for scenario, stem, own in title_stems(rows, "scenario"):
            snrs_db = charts.nearest_values(sorted(own["snr_db"].unique()), CLOUD_SNRS_DB)
            trial = int(own["trial"].min())
            yield from cloud_figures(run, lines, scenario, f"clouds-{stem}", snrs_db, trial)


def _chosen_figures(run: Run, rows: pd.DataFrame, choice: FigureChoice) -> Iterator[Drawing]:
    """Chosen figures of a run by the stems of their files."""
    lines, summary = lines_of(rows), summarise_scores(rows)
    is_of_images = choice.snr_db is not None or choice.trial is not None
    for scenario, stem, own in title_stems(rows, "scenario"):
        if choice.metric is not None or not is_of_images:
            part, curves = summary[summary["scenario"] == scenario], f"{choice.metric or 'curves'}-{stem}"
            scores = [choice.metric] if choice.metric else [name for name in SCORES if f"{name}_mean" in part]
            yield from drawings_of([score_charts(part, scores, curves, lines, run.scenarios[scenario])])
        if choice.metric is not None and not is_of_images:
            continue
        trial = int(own["trial"].min()) if choice.trial is None else choice.trial
        wanted_db = CLOUD_SNRS_DB if choice.snr_db is None else [choice.snr_db]
        snrs_db = charts.nearest_values(sorted(own["snr_db"].unique()), wanted_db)
        at = "" if choice.snr_db is None else f"-{snrs_db[0]:g}dB"
        yield from cloud_figures(run, lines, scenario, f"clouds-{stem}{at}-trial{trial}", snrs_db, trial)
        if is_of_images:
            yield from diagnosis_figures(run, scenario, snrs_db[-1], trial)


def _chosen_rows(run: Run, choice: FigureChoice) -> pd.DataFrame:
    """Rows of the chosen scenario; whatever else is chosen must be among them."""
    if not KINDS[run.kind].has_images:
        kinds = ", ".join(name for name, kind in KINDS.items() if kind.has_images)
        raise InputError(f"{run.label}: kind {run.kind}: allowed for a choice of figures are {kinds}")
    rows, names = run.rows, list(run.rows["scenario"].unique())
    if choice.scenario is not None:
        rows = rows[rows["scenario"] == choice.scenario]
    elif len(names) > MANY_SCENARIOS:
        raise InputError(
            f"{run.label}: {len(names)} scenarios are too many for figures of each; give --scenario"
        )
    choices: list[tuple[str, Any, list[Any]]] = [
        ("scenario", choice.scenario, names),
        ("SNR in dB", choice.snr_db, sorted(rows["snr_db"].unique())),
        ("trial", choice.trial, sorted(rows["trial"].unique())),
        ("score", choice.metric, averaged_columns(rows)),
    ]
    for noun, wanted, allowed in choices:
        if wanted is not None and wanted not in allowed:
            form = "{}" if isinstance(wanted, str) else "{:g}"
            error = unknown_name(noun, form.format(wanted), map(form.format, allowed))
            raise InputError(f"{run.label}: {error}")
    return rows


def radius_charts(run: Run, lines: Mapping[Variant, Line]) -> list[ChartGroup]:
    """F-score, precision and recall of matched points over the radius, first trials at the highest SNR."""
    rows = run.rows
    top_db, first = rows["snr_db"].max(), int(rows["trial"].min())
    is_drawn = (rows["snr_db"] == top_db) & (rows["trial"] == first) & ~failed(rows)
    curves: dict[Variant, list[Curve]] = {}
    for place in np.flatnonzero(is_drawn).tolist():
        name, estimator, params = rows[["scenario", "estimator", "params"]].iloc[place]
        pair = CloudPair.of(run.scenarios[name], PointCloud.from_array(run.points[place]))
        curves.setdefault((estimator, params), []).append(score_curve(pair))
    if not curves:
        return []
    means = {variant: Curve(*np.nanmean(curves[variant], axis=0)) for variant in lines if variant in curves}
    x = Axis("radius [m]", log=True)
    panels = []
    for name, heading in (("f_score", "F-score"), ("precision", "precision"), ("recall", "recall")):
        series = []
        for variant, mean in means.items():
            label = f"{lines[variant].label}: area {mean.area:.2f}"
            style = replace(lines[variant].style, symbol="")
            series.append(Series(label, mean.radius_m, getattr(mean, name), style=style))
        panels.append(Chart(heading, x, Axis(heading, limits=(0.0, 1.02)), series))
    n_scenes = plural(rows.loc[is_drawn, "scenario"].nunique(), "scene")
    title = f"Points matched one to one within a radius, {top_db:g} dB, {n_scenes}"
    return [ChartGroup("radii", title, panels)]


def cloud_figures(
    run: Run, lines: Mapping[Variant, Line], scenario: str, stem: str, snrs_db: Sequence[float], trial: int
) -> Iterator[Drawing]:
    """Draw clouds of one scenario and trial beside the truth, a row an SNR, a few estimators a figure."""
    # A run of references alone still has clouds to show.
    candidates = [variant for variant, line in lines.items() if not line.is_reference] or list(lines)
    variants = best_variants(run.rows[run.rows["scenario"] == scenario], candidates)
    title = drawable(scenario)
    if len(variants) < len(candidates):
        title += f", the {len(variants)} of {len(candidates)} estimators with the least mean deviation"
    images, scene = _images(run, scenario, trial), run.scenarios[scenario]
    pages = charts.batched(variants, CLOUDS_A_FIGURE)
    for number, page in enumerate(pages, start=1):
        panels: list[tuple[str, Image]] = []
        for snr_db in snrs_db:
            panels.append((f"SNR {snr_db:g} dB: truth", image_of_truth(scene.truth)))
            panels += [(lines[one].label, images.get((*one, snr_db), NOT_RUN)) for one in page]
        heading, suffix = f"{title}, trial {trial}", f"-{number}" if len(pages) > 1 else ""
        seen = scene.truth, scene.region, scene.radius_m
        yield f"{stem}{suffix}", partial(draw_clouds, heading, *seen, panels, 1 + len(page))


def _images(run: Run, scenario: str, trial: int) -> dict[tuple[str, str, float], Image]:
    """Images of one trial of a scenario, by name, parameters and SNR."""
    is_own, images = (run.rows["trial"] == trial) & (run.rows["scenario"] == scenario), {}
    for place in np.flatnonzero(is_own).tolist():
        row, cloud = run.rows.iloc[place], PointCloud.from_array(run.points[place])
        note = "nothing detected" if row["status"] == "no_detection" else str(row["status"])
        if note == "ok":
            hausdorff_m = row[[*PROJECTIONS]].sum()
            note = f"{plural(len(cloud), 'point')}, Hausdorff sum {hausdorff_m:.1f} m"
        images[row["estimator"], row["params"], row["snr_db"]] = Image(cloud, note)
    return images


def _worst_images(run: Run, lines: Mapping[Variant, Line]) -> Iterator[Drawing]:
    """Draw the scene in which each estimator has its largest ratio, beside the truth."""
    cells, snr_db = with_ratios(run.rows), shown_snr_db(run.rows)
    rated = cells[cells["snr_db"] == snr_db].dropna(subset="ratio")
    chosen = [variant for variant, line in lines.items() if not line.is_reference][:MOST_WORST]
    stems = file_stems(lines[variant].label for variant in chosen)
    for variant, stem in zip(chosen, stems.values(), strict=True):
        scenes = charts.rows_of(rated, variant)
        if scenes.empty:
            continue
        worst = scenes.iloc[scenes["ratio"].argmax()]
        cloud = run.clouds.get(CellKey(*worst[CLOUD_KEYS]), PointCloud.empty())
        scene = run.scenarios[worst["scenario"]]
        title = f"{drawable(scene.name)} at {snr_db:g} dB: the worst ratio of {plural(len(scenes), 'scene')}"
        note = f"{plural(len(cloud), 'point')}, {worst['ratio']:.1f} times the Hausdorff sum of the oracle"
        image = lines[variant].label, Image(cloud, note)
        seen = scene.region, scene.radius_m
        yield f"worst-{stem}", partial(draw_comparison, title, scene.truth, *image, *seen)
