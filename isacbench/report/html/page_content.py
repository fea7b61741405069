"""Content of a page in terms of JSON: what was run, rows, scenes, ranks, times, and which clouds it holds."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.special import stdtrit

from isacbench import charts
from isacbench.bench.cells.rows import SCORED
from isacbench.bench.compare.comparison import VERDICTS, Comparison, direction
from isacbench.bench.compare.pairs import CURVE, code_version
from isacbench.bench.compare.ranking import default_metric, rank_table
from isacbench.bench.compare.scenes import SCENE_KINDS, compared_scenes
from isacbench.bench.compare.significance import MIN_INTERVAL_TRIALS
from isacbench.bench.kinds.scores import SCORES, Score
from isacbench.bench.labels import references_in
from isacbench.bench.run_times import STAGE_STYLES, is_timed, summarise_points, summarise_stages, timed_rows
from isacbench.bench.statistics import CONFIDENCE, MIN_TRIALS, TIME
from isacbench.bench.store.manifest import scenario_texts, stored_columns
from isacbench.bench.store.run import Run
from isacbench.bench.store.run_folder import NO_POINTS, sizes
from isacbench.bench.suites.suite_kinds import KINDS
from isacbench.charts import ROLES, Axis, ChartGroup, Line, Series, Variant
from isacbench.errors import InputError
from isacbench.files.escaping import plural
from isacbench.model.cloud import PointCloud
from isacbench.model.radio_coordinates import median_gain_db
from isacbench.report.clouds import SHOWN_SNR_DB, VELOCITY_COLOURS, shown_snr_db
from isacbench.report.comparison import ComparisonReport, Row
from isacbench.report.html.joined_runs import KEY, RUN, JoinedRuns
from isacbench.report.tables import json_rows

DEFAULT_METRIC = "deviation"
"""Metric that a page of fewer than six scenes shows first. A page of more shows what `rank` goes by."""

RANKED = ("ratio", "hausdorff_sum_m", "f_score", "objects_f_score", "deviation")
"""Metrics with rank sets; each takes a second for a hundred scenes."""

FURTHER_METRICS = {
    "ratio": "Hausdorff sum over that of the oracle, mean (summary.md has the median)",
    "n_estimated": "estimated points",
    TIME: "median processor time of an estimate [s]",
}

HIDDEN = ("seed", "suite", "environment", "scenario_content", "timing", "n_stored", RUN)
"""Columns of rows that a page leaves out."""

PLAIN_FACTS = (
    *("started", "wall_time_s", "seed", "processor", "cores", "platform"),
    *("python", "blas", "blas_threads"),
)
"""Keys of a manifest that a page shows as they are."""

DIGITS = 6
"""Significant digits of numbers in a page."""

MOST_FREEDOM = 200
"""Degrees of freedom from which on the page takes an approximation of the quantiles of Student's t."""

MOST_ROWS = 200_000
"""Most rows of a page. A million rows make one of 107 MB, which takes 95 s."""

MOST_POINTS = 1_500_000
"""Points of estimated clouds in a page: 7 MB in it, at 3.6 bytes a point before base64."""

LEVELS = 65_535
"""Steps between the smallest and the largest coordinate of a cloud: 1.5 mm of 100 m."""

POWER_LEVELS = 255

WEAKEST = 1e-30
"""Power below which all is as weak."""


def page_content(
    joined: JoinedRuns, metric: str | None = None, first: NDArray[np.bool_] | None = None
) -> tuple[dict[str, Any], bytes]:
    """Describe runs for a page: its content in terms of JSON, and the clouds in it, packed.

    `metric` is shown first, and ranked even if it is none of `RANKED`; by default `DEFAULT_METRIC` of fewer
    than six scenes, and what `rank` goes by of more. Clouds of the rows `first` must be in the page; the
    chosen ones are in the order of the rows, then come the truths. InputError if the rows are more than a
    browser can hold.
    """
    records = joined.table.rows
    if len(records) > MOST_ROWS:
        raise InputError(
            f"{joined.table.label}: {len(records)} rows are too many for a page; allowed are {MOST_ROWS}; "
            "tables and figures show them"
        )
    kind = KINDS[joined.table.kind]
    # A run that was published as rows alone has no truth in its folder; that of the other run is the same.
    imaged = {name: run for run in reversed(joined.runs) if run.has_scenarios for name in run.imaged_scenes}
    is_imaged = records["deviation"].notna() & records["scenario"].isin(imaged)
    has_image = is_imaged.to_numpy() & joined.table.is_whole()
    n_points = sizes(joined.table.points)
    chosen = has_image & choose_clouds(records, n_points, first)
    number = np.where(chosen, np.cumsum(chosen) - 1, -1)
    clouds = [joined.table.points[place] for place in np.flatnonzero(chosen)]
    scenes, truths = _scenes(records, imaged, len(clouds))
    clouds += [truth.to_array() for truth in truths]
    counts, points = sizes(clouds), np.concatenate([NO_POINTS, *clouds])
    lines = charts.assign_lines(joined.labels, references_in(records))
    metrics = _metrics(joined, imaged)
    is_many = records["scenario"].nunique() >= MIN_INTERVAL_TRIALS and "ratio" in records
    metric = metric or (default_metric(records) if is_many else DEFAULT_METRIC)
    content = {
        "metric": metric,
        "shown_snr_db": SHOWN_SNR_DB,
        "min_trials": MIN_TRIALS,
        "student": numbers(stdtrit(np.arange(1, MOST_FREEDOM), (1 + CONFIDENCE) / 2)),
        "notes": list(joined.notes),
        "suite_kind": joined.table.kind,
        "scored": list(SCORED),
        "velocity_colours": list(VELOCITY_COLOURS),
        "runs": [{"name": run.label, "facts": _facts(run.manifest)} for run in joined.runs],
        "estimators": [_estimator(joined, variant, line) for variant, line in lines.items()],
        "scenes": scenes,
        "metrics": metrics,
        "rows": {
            **_columns(joined, [scene["name"] for scene in scenes]),
            "cloud": number.tolist(),
            "has_image": has_image.tolist(),
        },
        "counts": counts.tolist(),
        "n_clouds_left_out": int((has_image & ~chosen & (n_points > 0)).sum()),
        "ranks": _ranks(joined, [one["name"] for one in metrics], metric),
        "times": _times(joined),
        # Images have views of their own instead.
        "charts": [] if kind.has_images else chart_rows(kind.charts(records)),
    }
    return content, pack_clouds(points, counts)


def _columns(joined: JoinedRuns, scenes: Iterable[str]) -> dict[str, Any]:
    """Columns of rows: numbers of estimator and scene, numbers, and texts as levels and codes."""
    records = joined.table.rows
    of_scene = {scene: number for number, scene in enumerate(scenes)}
    columns: dict[str, Any] = {
        "estimator": _numbers_of(joined, records["estimator"], records["params"]),
        "scene": [of_scene[scene] for scene in records["scenario"]],
    }
    for name in records.columns.drop(["scenario", "estimator", "params", *HIDDEN], errors="ignore"):
        values = records[name]
        if name == "snr_db":  # with all digits: other parts of the page name the same SNRs
            columns[name] = values.tolist()
        elif pd.api.types.is_numeric_dtype(values):
            if values.notna().any():
                columns[name] = numbers(values.astype(float) if values.dtype == bool else values)
        else:
            codes, levels = pd.factorize(values.astype(object).fillna(""))
            columns[name] = {"codes": codes.tolist(), "levels": [str(level) for level in levels]}
    return columns


def _numbers_of(joined: JoinedRuns, names: Iterable[str], params: Iterable[str]) -> list[int]:
    """Numbers of estimators in the page."""
    places = {variant: number for number, variant in enumerate(joined.labels)}
    return [places[variant] for variant in zip(names, params, strict=True)]


def _scenes(
    records: pd.DataFrame, imaged: Mapping[str, Run], n_clouds: int
) -> tuple[list[dict[str, Any]], list[PointCloud]]:
    """Scenes of the rows, and the truths of those that were imaged: one, or one a trial where trials draw.

    Truths are numbered from the number of clouds in the page on.
    """
    scenes: list[dict[str, Any]] = []
    truths: list[PointCloud] = []
    for name in dict.fromkeys(records["scenario"].astype(object)):
        if name not in imaged:
            scenes.append({"name": name, "family": "", "truth": []})
            continue
        run = imaged[name]
        scene = run.imaged_scenes[name]
        template, region = scene.template, scene.template.region
        trials: list[int | None] = [None]
        if scene.is_drawn:
            trials = sorted(set(records.loc[records["scenario"] == name, "trial"].tolist()))
        observed = [template if trial is None else run.observed(name, trial) for trial in trials]
        objects = observed[0].scatterers.objects if len(observed) == 1 else ()
        codes, levels = pd.factorize(np.array(objects, dtype=object))
        scenes.append(
            {
                "name": name,
                "family": template.family,
                "truth": [[trial, place] for place, trial in enumerate(trials, n_clouds + len(truths))],
                "frame": run.manifest["scenarios"].get(template.name, {}).get("frame", {}).get("name", ""),
                "coherent_phase": template.system.coherent_phase,
                "radius_m": template.radius_m,
                "gain_db": numbers([median_gain_db(observed[0])])[0],
                "region_m": [list(region.x_m), list(region.y_m), list(region.z_m)],
                "speed_mps": max(map(abs, region.speed_mps)),
                "objects": {"codes": codes.tolist(), "levels": list(levels)},
                "text": scenario_texts(run.manifest).get(name, ""),
                "seed": int(run.manifest["seed"]),
            }
        )
        truths += [one.truth for one in observed]
    return scenes, truths


def _estimator(joined: JoinedRuns, variant: Variant, line: Line) -> dict[str, Any]:
    return {
        "label": joined.labels[variant],
        "spec": joined.specs[variant],
        "name": variant[0],
        "params": variant[1],
        "run": int(charts.rows_of(joined.table.rows, variant)[RUN].iloc[0]),
        "is_reference": line.is_reference,
        "role": ROLES.get(variant[0], "sees the truth") if line.is_reference else "",
        **asdict(line.style),
    }


def _facts(manifest: Mapping[str, Any]) -> dict[str, str]:
    """Suite, command, machine and versions of a run, in words."""
    suite, packages = manifest["suite"], manifest.get("packages") or {}
    return {
        "suite": str(suite.get("name")) + (f", version {suite['version']}" if "version" in suite else ""),
        "command": " ".join(map(str, manifest.get("argv") or [])) or "from Python",
        "isacbench": code_version(manifest),
        **{name.replace("_", " "): str(manifest.get(name)) for name in PLAIN_FACTS},
        "packages": ", ".join(f"{name} {version}" for name, version in packages.items()),
        "interrupted": "yes: cells are missing" if manifest.get("interrupted") else "",
    }


def _metrics(joined: JoinedRuns, imaged: Mapping[str, Run]) -> list[dict[str, Any]]:
    """Columns that have a better direction and any value."""
    records = joined.table.rows
    columns = records.select_dtypes(["number", "bool"]).columns.drop(["snr_db", "trial", RUN])
    described = stored_columns(joined.table.manifest)
    metrics = []
    for name in dict.fromkeys([*SCORES, *FURTHER_METRICS, *columns]):
        if name not in columns or not records[name].notna().any() or name.endswith("_spread"):
            continue
        try:
            better: str = direction(name, described, columns)
        except InputError:
            if name != "n_estimated":
                continue
            better = "neither"
        plain = described[name].title if name in described else FURTHER_METRICS.get(name, name)
        score = SCORES.get(name, Score(plain, "log" if name == TIME else "linear"))
        metrics.append(
            {
                "name": name,
                "title": plain,
                "axis": score.name,
                "better": better,
                "log": score.scale == "log",
                "spread": f"{name}_spread" if f"{name}_spread" in records else "",
                "is_median": name == TIME,
            }
        )
    return metrics


def _ranks(joined: JoinedRuns, metrics: Collection[str], metric: str) -> dict[str, Any]:
    """Rank sets by metric; or the reason why there are none."""
    names = [name for name in dict.fromkeys([metric, *RANKED]) if name in metrics]
    n_scenes = joined.table.rows["scenario"].nunique()
    if joined.table.kind in SCENE_KINDS and n_scenes < MIN_INTERVAL_TRIALS:  # without the work of a ranking
        return {name: _too_few(n_scenes) for name in names}
    return {name: _rank_sets(joined, name) for name in names}


def _too_few(n_scenes: int) -> dict[str, Any]:
    return {"reason": f"{plural(n_scenes, 'scene')}: six or more have ranks"}


def _rank_sets(joined: JoinedRuns, metric: str) -> dict[str, Any]:
    try:
        ranking = rank_table(joined.table, metric)
    except InputError as error:
        return {"reason": str(error)}
    if ranking.is_descriptive:
        return _too_few(len(ranking.scores))
    parts = {}
    for part in ("ranks", "wins", "worst"):
        table = getattr(ranking, part)
        for one, params in (("estimator", "params"), ("other", "other_params")):
            if one in table:
                own = _numbers_of(joined, table[one], table[params])
                table = table.assign(**{one: own}).drop(columns=params)
        parts[part] = json_rows(table)
    return {"better": ranking.better, "notes": list(ranking.notes), **parts}


def _times(joined: JoinedRuns) -> dict[str, Any]:
    """Points of run time against error with their stages; empty where nothing was timed."""
    records = joined.table.rows
    rows = timed_rows(records)
    if rows.empty or not is_timed(records) or rows["deviation"].isna().all():
        return {}
    points = summarise_points(rows)
    variants = zip(points["estimator"], points["params"], strict=True)
    points["label"] = [joined.labels[variant] for variant in variants]
    colours = {f"time_{stage}_s_median": style.colour for stage, style in STAGE_STYLES.items()}
    stages = json_rows(summarise_stages(rows))
    return {"points": json_rows(points), "stages": stages, "stage_colours": colours}


def chart_rows(groups: Iterable[ChartGroup]) -> list[dict[str, Any]]:
    """Describe charts: each has the title of its group, its own, axes, series and lines across."""
    return [
        {
            "group": group.title,
            "title": chart.title,
            "x": _axis(chart.x),
            "y": _axis(chart.y),
            "lines": [float(value) for value in chart.lines],
            "series": [_series(one) for one in chart.series],
        }
        for group in groups
        for chart in group.charts
    ]


def _axis(axis: Axis) -> dict[str, Any]:
    return {"title": axis.title, "log": axis.log, "range": axis.limits and list(map(float, axis.limits))}


def _series(series: Series) -> dict[str, Any]:
    return {
        "label": series.label,
        **asdict(series.style),
        **{name: numbers(np.asarray(getattr(series, name), float)) for name in ("x", "y", "low", "high")},
    }


def numbers(values: ArrayLike) -> list[float | None]:
    """Write numbers for JSON, with six significant digits; None for what is not finite.

    Examples
    --------
    >>> numbers([1.23456789, np.nan, 2])
    [1.23457, None, 2.0]
    """
    listed: list[float | int] = np.asarray(values).tolist()
    return [
        number if isinstance(number, int) else float(f"{number:.{DIGITS}g}") if np.isfinite(number) else None
        for number in listed
    ]


def pack_clouds(points: NDArray[np.float64], n_points: NDArray[np.int64]) -> bytes:
    """Quantise clouds, each between its own limits, for compression and for a quick start of a page.

    `points` has x, y, z in m, v in m/s and power of one cloud after the other. Returned is little-endian
    float32 of shape (n, 10): lowest value and step of x, y, z, v, and of the power in dB; then bytes, of all
    points: high and low byte of x, of y, of z, of v, and one byte of power.
    """
    values = points.copy()
    values[:, 4] = 10 * np.log10(np.maximum(points[:, 4], WEAKEST))
    limits, filled = np.zeros((len(n_points), 10), dtype="<f4"), np.flatnonzero(n_points)
    levels = np.array([LEVELS, LEVELS, LEVELS, LEVELS, POWER_LEVELS])
    if filled.size:
        first = (np.cumsum(n_points) - n_points)[filled]
        lowest = np.minimum.reduceat(values, first)
        limits[filled, 0::2] = lowest
        limits[filled, 1::2] = (np.maximum.reduceat(values, first) - lowest) / levels
    own = np.repeat(limits.astype(np.float64), n_points, axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        steps = np.nan_to_num((values - own[:, 0::2]) / own[:, 1::2], posinf=0.0, neginf=0.0)
    whole = np.clip(np.rint(steps), 0, levels).astype(np.uint16)
    planes = [plane for axis in range(4) for plane in (whole[:, axis] >> 8, whole[:, axis] & 255)]
    return limits.tobytes() + b"".join(plane.astype(np.uint8).tobytes() for plane in [*planes, whole[:, 4]])


def choose_clouds(
    records: pd.DataFrame,
    n_points: NDArray[np.int64],
    first: NDArray[np.bool_] | None = None,
    most_points: int = MOST_POINTS,
) -> NDArray[np.bool_]:
    """Choose the clouds that a page holds, the most wanted ones first.

    The order is: the clouds that the caller wants first; of every scene and
    estimator the first trial at the SNR nearest 10 dB; its cell of largest
    deviation; the first trial at other SNRs; then further trials.

    `first` are the rows whose clouds the caller wants; `most_points` is the sum of all clouds.
    """
    if n_points.sum() <= most_points:
        return np.ones(len(records), dtype=np.bool_)
    trial_number = np.searchsorted(np.unique(records["trial"]), records["trial"])
    order = 2 + trial_number
    deviations = records.reset_index(drop=True).fillna({"deviation": -np.inf})
    worst = deviations.groupby(CURVE, observed=True)["deviation"].idxmax()
    order[worst] = np.minimum(order[worst], 1)
    order[(trial_number == 0) & (records["snr_db"] == shown_snr_db(records)).to_numpy()] = 0
    if first is not None:
        order[first] = -1
    sequence = np.argsort(order, kind="stable")
    chosen = np.zeros(len(records), dtype=np.bool_)
    chosen[sequence] = np.cumsum(n_points[sequence]) <= most_points
    return chosen


def compared_content(comparison: Comparison, joined: JoinedRuns) -> tuple[dict[str, Any], NDArray[np.bool_]]:
    """Describe a comparison in terms of JSON, and tell which rows of the joined runs it shows.

    `joined` are the compared runs with all estimators named after their run, or the only run. The content
    has ``rows``: curves and changed points, the worst verdict first, each with the numbers of both estimators
    in the page and the cell that got worse most. Rows of the joined runs that are such cells are shown.
    """
    report = ComparisonReport(comparison)
    tables = [comparison.curves.assign(what="curve"), report.changed_points().assign(what="point")]
    rows = pd.concat(tables, ignore_index=True)
    order = np.lexsort((-rows["relative"].abs().fillna(0), rows["verdict"].map(VERDICTS.index)))
    groups = compared_scenes(joined.table.manifest, joined.table.rows["scenario"].astype(object))
    is_shown = np.zeros(len(joined.table.rows), dtype=np.bool_)
    names = list(joined.labels)
    listed = []
    for row in json_rows(rows.iloc[order]):
        pair = comparison.between or (
            (row["estimator"], row["params"]),
            (row["new_estimator"], row["new_params"]),
        )
        sides = []
        for (name, params), run in zip(pair, (joined.runs[0], joined.runs[-1]), strict=True):
            own = [(f"{name} ({run.label})", params), (name, params)]  # under its own name, or with its run
            sides.append(next((one for one in own if one in joined.labels), None))
        base, new = (None if side is None else names.index(side) for side in sides)
        worst = None
        if base is not None and new is not None:
            scenes = groups.get(row["scenario"], [row["scenario"]])
            worst = _worst_cell(joined, row, scenes, names[base], names[new], is_shown)
        listed.append({**row, "base": base, "new": new, "worst": worst})
    lost = [
        {"what": what, "n": len(cells), "cells": json_rows(cells.head(50))}
        for cells, what in report.lost + report.gained
        if len(cells)
    ]
    content = {
        "summary": report.summary(),
        "heading": [*report.heading, *report.effect_lines()],
        "lines": report.lines(),
        "sides": list(report.sides),
        "unit": comparison.unit,
        "tolerances": list(map(str, comparison.tolerances)),
        "rows": listed,
        "lost": lost,
        "is_regression": bool(comparison.is_regression),
    }
    return content, is_shown


def _worst_cell(
    joined: JoinedRuns, row: Row, scenes: list[str], base: Variant, new: Variant, is_shown: NDArray[np.bool_]
) -> dict[str, Any] | None:
    """Cell in which a score got worse most; its two rows are marked as shown."""
    records, metric = joined.table.rows, row["metric"]
    wanted = records[records["scenario"].isin(scenes)]
    if row.get("snr_db") is not None:
        wanted = wanted[wanted["snr_db"] == row["snr_db"]]
    sides = [charts.rows_of(wanted, variant)[[*KEY, metric]].reset_index() for variant in (base, new)]
    pairs = sides[0].merge(sides[1], on=KEY, suffixes=("_base", "_new"))
    change = pairs[f"{metric}_new"].astype(float) - pairs[f"{metric}_base"].astype(float)
    if change.isna().all():
        return None
    better = direction(metric, stored_columns(joined.table.manifest), records.columns)
    worst = pairs.iloc[change.argmax() if better == "lower" else change.argmin()]
    is_shown[[worst["index_base"], worst["index_new"]]] = True
    return {"scene": worst["scenario"], "snr_db": float(worst["snr_db"]), "trial": int(worst["trial"])}
