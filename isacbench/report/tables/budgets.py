"""Best estimator for each time budget, and the others that may be as good."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from isacbench.bench.compare.statistics import best_p_values, smallest_p_value, trials_needed
from isacbench.bench.plan.labels import find_limits
from isacbench.report.tables.pareto import summarise_points, timed_rows
from isacbench.report.tables.run_tables import Grid

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

ALPHA = 0.05
"""Largest probability that a table omits the truly best estimator in any of its rows."""

MARGIN = 0.01
"""Relative difference of mean deviations that does not matter."""

PANEL = ["scenario", "snr_db"]
DEVIATIONS = ["deviation_mean", "deviation_low", "deviation_high"]
TIMES = ["time_s", "time_low_s", "time_high_s"]
SHOWN = ["estimator", "params", "label", "n_trials", "n_no_detection", *DEVIATIONS, *TIMES]


def budget_series(shortest_s: float, longest_s: float) -> list[float]:
    """Time budgets in steps of 1, 2, 5: from the least for the shortest time to the least for the longest.

    Parameters
    ----------
    shortest_s, longest_s : float
        Positive, the shorter one first.

    Returns
    -------
    list of float

    Examples
    --------
    >>> budget_series(0.033, 0.4)
    [0.05, 0.1, 0.2, 0.5]
    """
    decades = range(math.floor(math.log10(shortest_s)), math.ceil(math.log10(longest_s)) + 1)
    # Parsed from text: 5e-2 is exactly the float 0.05, which 5 * 10**-2 might not be.
    series = [float(f"{step}e{decade}") for decade in decades for step in (1, 2, 5)]
    longest = next(budget_s for budget_s in series if budget_s >= longest_s)
    return [budget_s for budget_s in series if shortest_s <= budget_s <= longest]


def summarise_budgets(records: pd.DataFrame) -> pd.DataFrame:
    """Find the best estimator of a timed run for each scenario, SNR and time budget.

    An estimator keeps a budget if the upper limit of the 95 % interval of
    its median time does; with fewer than six trials, which have no interval,
    if the slowest of them does. Only estimators that scored every trial take
    part, without those that see the truth.

    Parameters
    ----------
    records : DataFrame
        Rows of a run.

    Returns
    -------
    DataFrame
        One row for each scenario, SNR and ``budget_s``: ``estimator``,
        ``params``, ``label``, ``n_trials``, ``n_no_detection``, deviation and
        time with intervals as `summarise_points` has them; ``n_within``, the
        number of estimators that keep the budget; ``may_be_best``, the labels
        (JSON, the fastest first) of those that are not shown to be worse than
        another by more than 1 % of the least mean deviation; ``level`` of that
        test (`isacbench.bench.compare.statistics.best_p_values`);
        ``trials_needed`` for any significant result at that level. With 95 %
        probability ``may_be_best`` holds the truly best estimator in all rows
        of a scenario and SNR. Empty where nothing was timed.
    """
    rows = timed_rows(records)
    if rows.empty:
        return pd.DataFrame()
    points = summarise_points(records, find_limits(rows))
    competitors = points[points["is_complete"] & ~points["is_limit"]]
    parts = [part for _, part in competitors.groupby(PANEL, sort=False)]
    return pd.DataFrame([row for part in parts for row in _rows(part, _deviations(rows, part))])


def budget_grids(records: pd.DataFrame) -> list[Grid]:
    """Tabulate the best estimator for each time budget, one table for each scenario and SNR.

    Parameters
    ----------
    records : DataFrame
        Rows of a run.

    Returns
    -------
    list of Grid
        Empty where nothing was timed.
    """
    summary = summarise_budgets(records)
    if summary.empty:
        return []
    return [_grid(part) for _, part in summary.groupby(PANEL, sort=False)]


def _rows(points: pd.DataFrame, deviations: Floats) -> Iterator[dict[str, object]]:
    """Rows of one scenario and SNR, from its competitors and their deviations (n_trials, n)."""
    limit_s = points["time_high_s"].fillna(points["time_slowest_s"]).to_numpy()
    by_time = np.argsort(points["time_s"].to_numpy(), kind="stable")
    by_error = np.lexsort([limit_s, points["deviation_mean"].to_numpy()])
    within = {
        budget_s: by_time[limit_s[by_time] <= budget_s]
        for budget_s in budget_series(float(limit_s.min()), float(limit_s.max()))
    }
    # A larger budget that adds no estimator repeats a test, and needs no level of its own.
    level = ALPHA / len({chosen.tobytes() for chosen in within.values()})
    for budget_s, keeping in within.items():
        best = points.iloc[next(place for place in by_error if place in keeping)]
        margin = MARGIN * abs(float(best["deviation_mean"]))
        may_be_best = keeping[best_p_values(deviations[:, keeping], margin) > level]
        yield {
            **{name: best[name] for name in PANEL},
            "budget_s": budget_s,
            **{name: best[name] for name in SHOWN},
            "n_within": len(keeping),
            "level": level,
            "trials_needed": trials_needed(level),
            "may_be_best": json.dumps(points["label"].iloc[may_be_best].tolist(), ensure_ascii=False),
        }


def _deviations(rows: pd.DataFrame, points: pd.DataFrame) -> Floats:
    """Deviations (n_trials, n) of the points of one scenario and SNR."""
    chosen = rows[(rows[PANEL] == points[PANEL].iloc[0]).all(axis=1)]
    table = chosen.pivot_table(
        index="trial", columns=["estimator", "params"], values="deviation", observed=True
    )
    variants = list(zip(points["estimator"], points["params"], strict=True))
    return table[variants].to_numpy(dtype=np.float64)


def _grid(part: pd.DataFrame) -> Grid:
    """Grid of one scenario and SNR, one row for each budget."""
    first = part.iloc[0]
    n_trials, needed = int(first["n_trials"]), int(first["trials_needed"])
    trials = "one trial" if n_trials == 1 else f"{n_trials} trials"
    title = f"{first['scenario']}, {first['snr_db']:g} dB: least mean deviation within a time, {trials}"
    if smallest_p_value(n_trials) > first["level"]:
        title += f", too few to tell any apart: {needed} are needed"
    has_interval = part[["deviation_low", "time_low_s"]].notna().any()
    numbers = [
        f"{name} (95 %)" if shown else name
        for name, shown in zip(("deviation", "time [ms]"), has_interval, strict=True)
    ]
    header = ["within [ms]", "best", *numbers, "may be best", "the fastest of them"]
    return Grid(title, header, [_cells(entry) for _, entry in part.iterrows()])


def _cells(entry: pd.Series[Any]) -> list[str]:
    """Row of a budget: the best estimator with its scores, and which others may be best."""
    empty = f" ({entry['n_no_detection']} empty)" if entry["n_no_detection"] else ""
    may_be_best = json.loads(entry["may_be_best"])
    fastest = may_be_best[0]
    return [
        f"{1e3 * entry['budget_s']:g}",
        f"{entry['label']}{empty}",
        _with_interval("{:.2f}", *(entry[name] for name in DEVIATIONS)),
        _with_interval("{:.3g}", *(1e3 * entry[name] for name in TIMES)),
        f"{len(may_be_best)} of {entry['n_within']}",
        "the best" if fastest == entry["label"] else fastest,
    ]


def _with_interval(form: str, value: float, low: float, high: float) -> str:
    """Number, followed by its interval if it has one."""
    return form.format(value) + ("" if math.isnan(low) else f" ({form.format(low)}-{form.format(high)})")
