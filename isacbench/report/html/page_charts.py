"""Charts of a kind of suite in a page, in terms of JSON."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.bench.suites.suite_kinds import KINDS
from isacbench.report.html.page_file import numbers

if TYPE_CHECKING:
    from collections.abc import Iterable

    from isacbench.charts import Axis, Chart, ChartGroup, Series
    from isacbench.report.html.joined_runs import JoinedRuns


def page_charts(joined: JoinedRuns) -> list[dict[str, Any]]:
    """Charts of runs; images have views of their own instead."""
    kind = KINDS[joined.table.manifest["suite"].get("kind", "imaging")]
    return [] if kind.has_images else chart_rows(kind.charts(joined.table.rows))


def chart_rows(groups: Iterable[ChartGroup]) -> list[dict[str, Any]]:
    """Describe charts: each has the title of its group, its own, axes, series and lines across."""
    return [_chart(group.title, chart) for group in groups for chart in group.charts]


def _chart(group: str, chart: Chart) -> dict[str, Any]:
    return {
        "group": group,
        "title": chart.title,
        "x": _axis(chart.x),
        "y": _axis(chart.y),
        "lines": [float(value) for value in chart.lines],
        "series": [_series(one) for one in chart.series],
    }


def _axis(axis: Axis) -> dict[str, Any]:
    limits = None if axis.limits is None else [float(end) for end in axis.limits]
    return {"title": axis.title, "log": axis.log, "range": limits}


def _series(series: Series) -> dict[str, Any]:
    places = {name: getattr(series, name) for name in ("x", "y", "low", "high")}
    return {
        "label": series.label,
        "mark": series.mark,
        "colour": series.style.colour,
        "dash": series.style.dash,
        "symbol": series.style.symbol,
        "texts": list(series.texts),
        **{name: numbers(np.asarray(values, dtype=np.float64)) for name, values in places.items()},
    }
