"""The kind ``drops``: many drops of targets, judged together as 3GPP counts missed and false detections.

The drop is the unit: shares are means over drops, accuracies are quantiles over the detected targets of all
drops. Drops that differ in their seed and in the number of their targets alone belong together; those without
targets give the false alarms of Type 1.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from functools import partial
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pandas as pd

from isacbench import charts
from isacbench.bench import statistics
from isacbench.bench.cells.images import Image
from isacbench.bench.cells.rows import failed
from isacbench.bench.cells.task import ImagingTask, build_estimators
from isacbench.bench.kinds import kind
from isacbench.bench.kinds.kind import NO_SCENARIOS, SNR_GAIN, Kind, Scenarios
from isacbench.bench.suites.suite import Suite
from isacbench.charts import VARIANT, Axis, Chart, ChartGroup, Column, Line, Series, Table, Variant
from isacbench.checked_arrays import Floats
from isacbench.choices import Sensing
from isacbench.link.sensing.division import Signal
from isacbench.link.sensing.link_observation import SignalSimulator
from isacbench.metrics.geometry import CloudPair
from isacbench.metrics.sensing_targets import (
    ACCURACY_SHARE,
    ERRORS,
    OBJECTIVES,
    Category,
    NrIsac,
    Ts22137,
    associate,
    error_quantiles,
)
from isacbench.model.scenes.scene_families import is_family_spec
from isacbench.specifications import parse_spec, spell_spec

GATES_M = 1.0, 2.0, 3.0, 5.0, 7.5, 10.0, 15.0, 20.0, 30.0, 50.0
"""Gates of the curve."""

GROUP = ["configuration", "sensing", *VARIANT, "snr_db"]
SHARES = "missed_detection", "false_alarm_type1", "false_alarm_type2"
ACCURACIES = tuple(OBJECTIVES)[len(SHARES) :]
TITLES = {
    "missed_detection": "missed: targets [%]",
    "false_alarm_type1": "false alarm: Type 1 [%]",
    "false_alarm_type2": "false alarm: Type 2 [%]",
    "false_alarm_type2_pooled": "Type 2: pooled [%]",
    "horizontal_error_p90_m": "horizontal: 90 % [m]",
    "vertical_error_p90_m": "vertical: 90 % [m]",
    "radial_velocity_error_p90_mps": "radial velocity: 90 % [m/s]",
}
VERDICTS = *ERRORS, "missed", "false alarm"
"""Columns of the table of verdicts."""

SNR_AXIS = Axis("SNR, or offset from the link budget [dB]")
SHARE_AXIS = partial(Axis, limits=charts.SHARE_LIMITS)


class DropsSuite(Suite):
    """Suite of the kind ``drops``.

    Attributes
    ----------
    sensing : {"all", "prs"}
        Resource elements that are sensed with: the whole grid, or the PRS alone.
    """

    kind: str = "drops"
    sensing: Sensing = "all"


class DropsKind(Kind):
    """Missed targets, false detections and accuracies over many drops."""

    name = "drops"
    suite = DropsSuite
    columns: ClassVar = {
        **SNR_GAIN,
        "snr_effective_db": math.nan,
        **dict.fromkeys(["configuration", "sensing", "categories"], ""),
        **dict.fromkeys(["n_targets", "n_detections", "n_detected"], 0),
        **dict.fromkeys(["target_errors", "detected_by_gate"], ""),
    }
    better: ClassVar = {
        **dict.fromkeys(["n_detected"], "higher"),
        **dict.fromkeys([*SNR_GAIN, "snr_effective_db", "n_targets", "n_detections"], "neither"),
    }
    metrics = "nr-isac", "ts22137"
    has_scenes = True

    def tasks(self, suite: DropsSuite, scenarios: Scenarios) -> list[ImagingTask]:
        """Plan one task a drop."""
        entries, metrics = build_estimators(suite), self.metrics_of(suite)
        own = next((one for one in metrics.further if isinstance(one, NrIsac)), NrIsac())
        judge = next((one for one in metrics.further if isinstance(one, Ts22137)), Ts22137())
        common = {"sensing": suite.sensing, "categories": json.dumps(judge.categories)}
        return [
            ImagingTask(
                suite,
                scenario,
                entries,
                simulator=partial(SignalSimulator, signal=Signal(sensing=suite.sensing)),
                measure=partial(measure_drop, own),
                metrics=metrics,
                labels={"configuration": configuration_of(name), **common},
            )
            for name, scenario in scenarios.items()
        ]

    def summary(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Summarise the drops of every configuration, estimator and SNR.

        One row for each: ``snr_effective_db_median``; the counts ``n_drops``, with targets, ``n_empty_drops``
        and ``n_failed``, ``n_targets``, ``n_detections`` and ``n_detected``, of drops with targets; means
        over drops ``missed_detection`` and ``false_alarm_type2`` with ``..._low`` and ``..._high`` (Student's
        t), ``false_alarm_type1`` with that of Clopper and Pearson, like ``false_alarm_type2_pooled``, the
        share of all detections; the accuracies of `isacbench.metrics.sensing_targets.NrIsac` over all
        detected targets, with intervals; ``time_estimate_s_median``. Intervals hold in 95 % of all cases.
        """
        return statistics.summarise(rows, GROUP, _numbers)

    def tables(self, rows: pd.DataFrame) -> list[Table]:
        """Metrics of every configuration and estimator over SNR, and verdicts of categories."""
        tables, words = kind.number_tables(rows), statistics.time_words(rows)
        columns = [
            Column("SNR: or offset [dB]", "snr_db", "{:g}", part=0),
            Column("estimator", "label", part=0),
            Column("SNR: effective [dB]", "snr_effective_db_median", "{:.1f}", optional=1),
            *(Column(title, form=partial(_value_text, name)) for name, title in TITLES.items()),
            Column("failed: cells", "n_failed", optional=2),
            Column("time [ms]", "time_estimate_s_median", "{:.1f}", scale=1e3),
        ]
        summary = kind.with_labels(self.summary(rows)).sort_values("snr_db", kind="stable")
        for (name, sensing), part in summary.groupby(["configuration", "sensing"], sort=False):
            title = f"{name}, sensing {sensing}: {part['n_drops'].max()} drops with targets, "
            title += f"{part['n_empty_drops'].max()} without; {words}"
            tables.append(Table(title, columns, part))
        return [*tables, *self._verdict_tables(rows)]

    def _verdict_tables(self, rows: pd.DataFrame) -> list[Table]:
        """Categories of TS 22.137 that estimators keep, a table a configuration."""
        rows, tables = kind.with_labels(rows), []
        first = [Column("estimator", "label", part=0), Column("category", "category", part=0)]
        columns = [*first, *(Column(f"{name}: [%]", name) for name in VERDICTS)]
        for (name, sensing), part in rows.groupby(["configuration", "sensing"], sort=False):
            title = f"{name}, sensing {sensing}: SNRs from which limits of TS 22.137 are kept, and shares at "
            title += f"{part['snr_db'].max():g} dB with 95 % intervals"
            tables.append(Table(title, columns, verdicts(part)))
        return tables

    def charts(self, rows: pd.DataFrame, scenarios: Scenarios = NO_SCENARIOS) -> list[ChartGroup]:
        """Detection over false alarms, all metrics over SNR, and both over the gate."""
        summary, lines, groups = self.summary(rows), kind.lines_of(rows), []
        for name, stem, part in kind.title_stems(summary, "configuration"):
            own = rows[rows["configuration"] == name]
            panels = [_plane(part, lines)]
            for column, objective in OBJECTIVES.items():
                series = charts.line_series(part, lines, "snr_db", column, column)
                is_share = column in SHARES
                unit = TITLES[column].partition("[")[2].rstrip("]")
                y = SHARE_AXIS("share") if is_share else Axis(unit, log=True)
                panels.append(Chart(TITLES[column].partition(" [")[0], SNR_AXIS, y, series, [objective]))
            panels += _gate_charts(own, lines)
            title = f"{name}: {part['n_drops'].max()} drops with targets; lines: objectives of TR 38.765"
            groups.append(ChartGroup(f"drops-{stem}", title, panels, n_columns=3))
        return groups


def configuration_of(scenario: str) -> str:
    """Name what a drop has in common with others: its family and parameters, without seed and targets.

    Examples
    --------
    >>> configuration_of("uma-av[seed=3,targets=0,clutter=ground]")
    'uma-av[clutter=ground]'
    """
    if not is_family_spec(scenario):
        return scenario
    name, params = parse_spec(scenario)
    return spell_spec(name, {key: value for key, value in params.items() if key not in ("seed", "targets")})


def measure_drop(metric: NrIsac, image: Image) -> dict[str, Any]:
    """Count targets and detections of a drop, and keep the errors of detected targets, as JSON.

    ``detected_by_gate`` has the number of detected targets at each of `GATES_M`. The effective SNR is that of
    all targets and clutter, Σ|G|²/σ² on a resource element and virtual element; NaN without any.
    """
    pair, power = CloudPair.of(image.scenario, image.cloud), float(image.scenario.truth.power.sum())
    found = associate(pair, metric.gate_m, metric.grouping)
    by_gate = [associate(pair, gate_m, metric.grouping) for gate_m in GATES_M]
    echoes_db = 10 * math.log10(power) if image.scenario.budget and power else 0.0
    return {
        "snr_effective_db": image.snr_db + echoes_db if power else math.nan,
        "n_targets": found.n_targets,
        "n_detections": found.n_detections,
        "n_detected": len(found.errors),
        "target_errors": json.dumps(found.errors.tolist()),
        "detected_by_gate": json.dumps([len(each.errors) for each in by_gate]),
    }


def pooled_errors(rows: pd.DataFrame) -> Floats:
    """Errors (n, 3) of the detected targets of all drops."""
    errors = [each for text in rows["target_errors"] if text for each in json.loads(text)]
    return np.array(errors, dtype=np.float64).reshape(-1, len(ERRORS))


def _numbers(part: pd.DataFrame) -> dict[str, Any]:
    """Numbers of the drops of one configuration, estimator and SNR."""
    broken = failed(part)
    drops = part[~broken]
    full, empty = drops[drops["n_targets"] > 0], drops[drops["n_targets"] == 0]
    counts = {name: int(full[name].sum()) for name in ("n_targets", "n_detections", "n_detected")}
    n_false, n_alarms = counts["n_detections"] - counts["n_detected"], int((empty["n_detections"] > 0).sum())
    numbers: dict[str, Any] = {
        "snr_effective_db_median": full["snr_effective_db"].median(),
        "n_drops": len(full),
        "n_empty_drops": len(empty),
        "n_failed": int(broken.sum()),
        **counts,
    }
    means = {
        "missed_detection": 1 - full["n_detected"] / full["n_targets"],
        "false_alarm_type2": (1 - full["n_detected"] / full["n_detections"]).fillna(0.0),
    }
    for name, values in means.items():
        mean, band = values.mean(), float(statistics.student_band(values.std(), len(values)))
        numbers |= _with_ends(name, mean, (max(mean - band, 0.0), min(mean + band, 1.0)))
    shares = {
        "false_alarm_type1": (n_alarms, len(empty)),
        "false_alarm_type2_pooled": (n_false, counts["n_detections"]),
    }
    for name, (n, n_all) in shares.items():
        numbers |= _with_ends(name, n / n_all if n_all else math.nan, statistics.exact_interval(n, n_all))
    errors = pooled_errors(full)
    quantiles = error_quantiles(errors, ACCURACY_SHARE)
    for name, value, own in zip(ACCURACIES, quantiles, errors.T, strict=True):
        numbers |= _with_ends(name, value, statistics.quantile_interval(own, ACCURACY_SHARE))
    return numbers


def _with_ends(name: str, value: float, ends: tuple[float, float]) -> dict[str, float]:
    """A number and the ends of its interval, by their columns."""
    return {name: value, f"{name}_low": ends[0], f"{name}_high": ends[1]}


def _value_text(name: str, entry: Mapping[Any, Any]) -> str:
    """Value with its interval: a share in percent, or an accuracy."""
    scale = 1.0 if name in ACCURACIES else 100.0
    value, low, high = (scale * entry[f"{name}{end}"] for end in ("", "_low", "_high"))
    if math.isnan(value):
        return ""
    form = "{:.2f}" if name in ACCURACIES else "{:.1f}"
    limits = "" if math.isnan(low) else f" ({form.format(low)}-{form.format(high)})"
    return form.format(value) + limits


def verdicts(rows: pd.DataFrame) -> list[dict[str, str]]:
    """Judge the estimators of labelled rows of one configuration by the categories of TS 22.137.

    Returns
    -------
    list of dict
        For each ``label`` and ``category`` a text for each of `VERDICTS`: the lowest SNR offset from which on
        the limit is kept, and the share with its 95 % interval at the highest one. It is that of detected
        targets whose error is within the limit, of missed targets, or of false detections. A limit is kept
        where the whole interval keeps it, and open where a part does.
    """
    found = []
    for label, part in rows.groupby("label", sort=False):
        drops = part[~failed(part) & (part["n_targets"] > 0)]
        for number, limits in enumerate(json.loads(part["categories"].iloc[0]), 1):
            judged = {
                snr_db: _judged(drops[drops["snr_db"] == snr_db], Category(*limits))
                for snr_db in drops["snr_db"].unique().tolist()
            }
            names = judged[max(judged)] if judged else ()
            texts = {name: _verdict({snr_db: own[name] for snr_db, own in judged.items()}) for name in names}
            found.append({"label": str(label), "category": str(number), **texts})
    return found


class _Share(NamedTuple):
    """Share, and the limits between which it is kept."""

    n: int
    n_all: int
    least: float = 0.0
    most: float = 1.0

    @property
    def ends(self) -> tuple[float, float]:
        """Interval of the share; from 0 to 1 of nothing."""
        return statistics.exact_interval(self.n, self.n_all) if self.n_all else (0.0, 1.0)

    @property
    def word(self) -> str:
        """Say of the limits that they are kept, or not, or that it is open."""
        low, high = self.ends
        if self.least <= low and high <= self.most:
            return "kept"
        return "no" if high < self.least or low > self.most else "open"


def _judged(drops: pd.DataFrame, category: Category) -> dict[str, _Share]:
    """Shares of drops with targets that a category limits."""
    errors = pooled_errors(drops)
    judged = {
        name: _Share(int((errors[:, place] <= limit).sum()), len(errors), least=category.confidence)
        for name, place, limit in category.judged()
    }
    n_targets, n_found, n_detected = (
        int(drops[name].sum()) for name in ("n_targets", "n_detections", "n_detected")
    )
    judged["missed"] = _Share(n_targets - n_detected, n_targets, most=category.missed)
    judged["false alarm"] = _Share(n_found - n_detected, n_found, most=category.false_alarm)
    return judged


def _verdict(shares: Mapping[float, _Share]) -> str:
    """Text of a limit by SNR: from which one on it is kept, and the share at the highest."""
    last = shares[max(shares)]
    word = last.word
    if word == "kept":
        above_db = max((snr_db for snr_db, one in shares.items() if one.word != "kept"), default=-math.inf)
        word = f"from {min(snr_db for snr_db in shares if snr_db > above_db):g} dB"
    low, high = last.ends
    share = f"{100 * last.n / last.n_all:.3g} ({100 * low:.2g}-{100 * high:.3g})" if last.n_all else ""
    return f"{word}: {share}".rstrip(": ")


def _plane(part: pd.DataFrame, lines: Mapping[Variant, Line]) -> Chart:
    """Detection over false alarms of Type 2, a line through the SNRs of each estimator."""
    series = []
    for variant, line in lines.items():
        own = charts.rows_of(part, variant).sort_values("snr_db")
        if not own.empty:
            found = 1 - own["missed_detection"]
            series.append(Series(line.label, own["false_alarm_type2"], found, style=line.style))
    objective = 1 - OBJECTIVES["missed_detection"]
    return Chart("detected over false", SHARE_AXIS("Type 2"), SHARE_AXIS("detected"), series, [objective])


def _gate_charts(rows: pd.DataFrame, lines: Mapping[Variant, Line]) -> list[Chart]:
    """Missed targets and false detections over the gate, at the highest SNR."""
    top = rows[~failed(rows) & (rows["n_targets"] > 0) & (rows["detected_by_gate"] != "")]
    top = top[top["snr_db"] == top["snr_db"].max()]
    missed: list[Series] = []
    false: list[Series] = []
    for variant, line in lines.items():
        own = charts.rows_of(top, variant)
        detected = np.array([json.loads(text) for text in own["detected_by_gate"]]).reshape(len(own), -1)
        for panel, total in ((missed, "n_targets"), (false, "n_detections")):
            n = own[[total]].to_numpy()
            share = ((n - detected) / np.maximum(n, 1)).mean(axis=0)
            panel += [Series(line.label, GATES_M, share, style=line.style)] if len(own) else []
    x, y = Axis("gate [m]", log=True), SHARE_AXIS("share")
    return [Chart("missed over the gate", x, y, missed), Chart("Type 2 over the gate", x, y, false)]
