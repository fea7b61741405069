"""Write the tables of measured numbers into README and docs, from the rows committed in results/reference.

    python docs/scripts/tables.py

A page has a table between ``<!-- table NAME -->`` and ``<!-- end -->``. `pytest` fails where a page and
the rows disagree (tests/documents/test_tables.py).
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import pandas as pd

from isacbench.bench.compare.ranking import Ranking, rank_table, rank_text
from isacbench.bench.kinds.detection import DetectionKind
from isacbench.bench.kinds.drops import DropsKind
from isacbench.bench.kinds.efficiency import EfficiencyKind
from isacbench.bench.kinds.kind import lines_of
from isacbench.bench.kinds.population import ALL, ratio_charts, summarise_population, with_ratios
from isacbench.bench.kinds.resolution import ResolutionKind
from isacbench.bench.kinds.scores import object_means, summarise_scores
from isacbench.bench.labels import estimator_labels, references_in
from isacbench.bench.run_times import pareto_charts, summarise_points
from isacbench.bench.store.run import Run
from isacbench.charts import Axis, Chart, ChartGroup, LineStyle, Series, variants_in
from isacbench.charts import rows_of as own_rows
from isacbench.report.figures import drawings_of, save_figures
from isacbench.report.ranking import ranking_charts, ranking_tables
from isacbench.report.tables import markdown as grid_markdown

ROOT = Path(__file__).resolve().parents[2]
PAGES = (
    "README.md",
    "docs/results.md",
    "docs/estimators.md",
    "docs/errata.md",
    "docs/pareto.md",
    "docs/rank.md",
    "docs/performance.md",
    "docs/3gpp.md",
)
MARKED = re.compile(r"<!-- table ([\w-]+) -->[^<]*<!-- end -->")

Cells = Sequence[str]
Variant = tuple[str, str]
VARIANT = ["estimator", "params"]
TOP_DB = 10.0
DIMENSIONS = "range", "velocity", "u", "w"


@cache
def rows_of(name: str) -> Run:
    """Rows and manifest of a committed run."""
    return Run.open(ROOT / "results" / "reference" / name).require_finished()


@cache
def labels_of(name: str) -> dict[Variant, str]:
    """Estimators of a run by name and parameters, as tables spell them, references last."""
    records = rows_of(name).rows
    limits, labels = references_in(records), estimator_labels(variants_in(records))
    return dict(sorted(labels.items(), key=lambda item: item[0][0] in limits))


def competing(name: str) -> dict[Variant, str]:
    """Estimators of a run that do not see the truth."""
    limits = references_in(rows_of(name).rows)
    return {variant: label for variant, label in labels_of(name).items() if variant[0] not in limits}


@cache
def population() -> pd.DataFrame:
    """Summary of the population."""
    return summarise_population(rows_of("population").rows)


@cache
def scenes(snr_db: float, family: str = ALL, frame: str = ALL, phases: str = ALL) -> pd.DataFrame:
    """Rows of the summary, indexed by estimator."""
    table = population()
    for name, value in {"snr_db": snr_db, "family": family, "frame": frame, "phases": phases}.items():
        table = table[table[name] == value]
    return table.set_index(VARIANT)


@cache
def resolutions() -> pd.DataFrame:
    """Summary of single scatterers and pairs."""
    return ResolutionKind().summary(rows_of("resolution").rows)


@cache
def ranking(snr_db: float) -> Ranking:
    """Ranks of the population at one SNR."""
    run = rows_of("population")
    return rank_table(run.take((run.rows["snr_db"] == snr_db).to_numpy()))


def ranks(snr_db: float) -> dict[Variant, str]:
    """Rank sets over all scenes; empty for references."""
    table = ranking(snr_db).ranks
    table = table[table["group"] == table["group"].iloc[0]].set_index(VARIANT)
    return {
        variant: "" if row["is_reference"] else rank_text(row["rank_low"], row["rank_high"])
        for variant, row in table.iterrows()
    }


def snrs_db() -> list[float]:
    """SNRs of the population, ascending."""
    return sorted(rows_of("population").rows["snr_db"].unique())


def number(value: float, form: str = ".2f") -> str:
    """Write a number; nothing where there is none."""
    return "" if math.isnan(value) else format(value, form)


def percent(value: float) -> str:
    """Write a share in per cent."""
    return "" if math.isnan(value) else f"{100 * value:.0f} %"


def seconds(time_s: float) -> str:
    """Write a time in seconds, with two digits."""
    return f"{time_s:#.2g}".removesuffix(".")


def markdown(header: Cells, rows: Iterable[Cells], left: int = 1) -> str:
    """Lay out a table, its first columns on the left."""
    rule = ["---"] * left + ["--:"] * (len(header) - left)
    return "\n".join(f"| {' | '.join(cells)} |" for cells in [header, rule, *rows])


def code(text: str) -> str:
    """Write a name as code."""
    return f"`{text}`"


def chosen() -> str:
    """Four estimators and the oracle on the population at 10 dB."""
    table = scenes(TOP_DB)
    rows = []
    for variant, label in labels_of("population").items():
        if label in ("fft4d", "music2d", "nomp4d", "sbl4d", "oracle"):
            row = table.loc[variant]
            rows.append(
                [
                    code(label),
                    number(row["ratio_median"]),
                    number(row["f_score_mean"]),
                    percent(row["objects_detected_mean"]),
                    number(row["n_objects_false_mean"], ".1f"),
                    seconds(row["time_estimate_s_median"]),
                ]
            )
    header = ["", "ratio", "F-score", "objects detected", "false objects", "time [s]"]
    return markdown(header, rows)


def over_snr() -> str:
    """Rank set, ratio and F-score of the population at each SNR."""
    header, columns = [""], []
    for snr_db in snrs_db():
        header += [f"{snr_db:g} dB: rank", "ratio", "F-score", "objects"]
        columns.append((scenes(snr_db), ranks(snr_db)))
    rows = []
    for variant, label in labels_of("population").items():
        cells = [code(label)]
        for table, rank in columns:
            row = table.loc[variant]
            cells += [rank[variant], number(row["ratio_median"])]
            cells += [number(row["f_score_mean"]), number(row["objects_f_score_mean"])]
        rows.append(cells)
    return markdown(header, rows)


def scores() -> str:
    """Scores of the population at 10 dB."""
    table, rank, rows = scenes(TOP_DB), ranks(TOP_DB), []
    header = ["", "rank", "median ratio (95 %)", "Hausdorff sum [m]", "F-score", "precision", "recall"]
    header += ["GOSPA skill", "velocity error [m/s]", "SSIM", "deviation", "time [s]"]
    for variant, label in labels_of("population").items():
        row = table.loc[variant]
        interval = f" ({row['ratio_low']:.2f} to {row['ratio_high']:.2f})"
        rows.append(
            [
                code(label),
                rank[variant],
                number(row["ratio_median"]) + interval,
                f"{row['hausdorff_sum_m_mean']:.2f} ± {row['hausdorff_sum_m_band']:.2f}",
                *(
                    number(row[f"{name}_mean"])
                    for name in ("f_score", "precision", "recall", "gospa_skill", "velocity_error_mps")
                ),
                *(number(row[f"{name}_mean"]) for name in ("ssim", "deviation")),
                seconds(row["time_estimate_s_median"]),
            ]
        )
    return markdown(header, rows)


def objects() -> str:
    """Objects of the population at 10 dB, by kind."""
    records = rows_of("population").rows
    means = object_means(records[records["snr_db"] == TOP_DB])
    kinds = [name for name in means if name.startswith("detected_")]
    header = ["", "F-score", "detected", "false an image"]
    header += [name.removeprefix("detected_").replace("_", " ") for name in kinds]
    header += ["horizontal [m]", "vertical [m]", "velocity [m/s]"]
    rows = []
    for variant, label in labels_of("population").items():
        row = means.loc[variant]
        cells = [code(label), number(row["objects_f_score"]), percent(row["objects_detected"])]
        cells += [number(row["n_objects_false"], ".1f"), *(percent(row[name]) for name in kinds)]
        errors = "objects_horizontal_m", "objects_vertical_m", "objects_velocity_mps"
        rows.append([*cells, *(number(row[name]) for name in errors)])
    return markdown(header, rows)


def families() -> str:
    """Median ratio and F-score of each family at 10 dB."""
    names = [name for name in population()["family"].unique() if name != ALL]
    tables = {name: scenes(TOP_DB, name) for name in names}
    rows = []
    for variant, label in labels_of("population").items():
        cells = [code(label)]
        for table in tables.values():
            row = table.loc[variant]
            cells.append("; ".join(filter(None, map(number, (row["ratio_median"], row["f_score_mean"])))))
        rows.append(cells)
    return markdown(["median ratio; F-score", *names], rows)


def conditions() -> str:
    """Median ratio by frame and phases at 10 dB."""
    tables = {
        f"{frame}, {phases}": scenes(TOP_DB, ALL, frame, phases)
        for frame in ("panel", "paper")
        for phases in ("in phase", "carrier")
    }
    rows = [
        [code(label), *(number(table.loc[variant]["ratio_median"]) for table in tables.values())]
        for variant, label in labels_of("population").items()
    ]
    return markdown(["median ratio", *tables], rows)


PAIRS = (
    ("fft4d[integration=beams]", "fft4d"),
    ("music2d[integration=beams]", "music2d"),
    ("music2d", "fft4d"),
    ("capon2d", "music2d"),
    ("music2d[search=root]", "music2d"),
    ("iaa2d", "music2d"),
    ("esprit2d", "music2d"),
    ("nomp4d", "omp4d"),
    ("nomp4d", "music2d"),
    ("sbl4d", "nomp4d"),
)


def pairs() -> str:
    """Change of the mean ratio and win probability of some pairs, at each SNR."""
    variants = {label: variant for variant, label in labels_of("population").items()}
    header, tables = ["", "than"], []
    for snr_db in snrs_db():
        header += [f"{snr_db:g} dB: ratio", "better on"]
        wins = ranking(snr_db).wins
        wins = wins[wins["group"] == wins["group"].iloc[0]]
        tables.append(wins.set_index([*VARIANT, "other", "other_params"]).sort_index())
    rows = []
    for one, other in PAIRS:
        cells = [code(one), code(other)]
        for table in tables:
            row = table.loc[(*variants[one], *variants[other])]
            cells.append(f"{row['change']:+.2f} ({row['change_low']:+.2f} to {row['change_high']:+.2f})")
            cells.append(percent(row["probability"]))
        rows.append(cells)
    return markdown(header, rows, left=2)


def rank_example() -> str:
    """Ranks and win probabilities of five estimators, as `isacbench rank` prints them."""
    five = ["sbl4d", "nomp4d", "esprit2d", "music2d", "fft4d"]
    tables = ranking_tables(rank_table(rows_of("population"), estimators=five))
    return "\n".join(map(grid_markdown, tables[:2])).strip()


def lone() -> str:
    """Targets of lone scatterers."""
    tables = [scenes(snr_db, "sparse") for snr_db in snrs_db()]
    header = ["", *(f"resolved at {snr_db:g} dB" for snr_db in snrs_db())]
    header += [f"false points an image at {snr_db:g} dB" for snr_db in snrs_db()]
    rows = [
        [
            code(label),
            *(number(table.loc[variant]["share_resolved_mean"]) for table in tables),
            *(number(table.loc[variant]["n_false_mean"]) for table in tables),
        ]
        for variant, label in competing("population").items()
    ]
    return markdown(header, rows)


def places() -> str:
    """Rank set, mean places by family, cost and resolution of each estimator."""
    found = ranking(TOP_DB)
    place = found.scores.rank(axis=1, ascending=found.better == "lower")
    family = place.index.str.partition("[").get_level_values(0)
    means, rank, table = place.groupby(family, sort=False).mean(), ranks(TOP_DB), scenes(TOP_DB)
    apart = told_apart()
    header = ["", "rank", "time [s]", "tells apart", "all", *means.index]
    rows = []
    for variant in place.mean().sort_values().index:
        label = labels_of("population")[variant]
        cells = [code(label), rank[variant], seconds(table.loc[variant]["time_estimate_s_median"])]
        cells += [apart.get(label, ""), number(place[variant].mean(), ".1f")]
        rows.append([*cells, *(number(value, ".1f") for value in means[variant])])
    return markdown(header, rows)


def told_apart() -> dict[str, str]:
    """Least distance along u from which nine of ten pairs are told apart, in Rayleigh cells."""
    table = resolutions()
    table = table[table["dimension"] == "u"].sort_values("separation_cells", ascending=False)
    found = {}
    for variant, label in labels_of("resolution").items():
        own = own_rows(table, variant)
        is_told = (own["resolved"] >= 0.9).cummin()
        found[label] = f"{own['separation_cells'][is_told].min():g} cells" if is_told.any() else "none"
    return found


def street() -> str:
    """Hausdorff sum and F-score on the paper's streets."""
    table = summarise_scores(rows_of("paper").rows)
    labels, names = labels_of("paper"), table["scenario"].unique()
    header = ["SNR [dB]"]
    header += [f"{name} {code(label)}" for name in names for label in labels.values()]
    indexed = table.set_index(["scenario", *VARIANT, "snr_db"])
    rows = []
    for snr_db in sorted(table["snr_db"].unique()):
        cells = [f"{snr_db:g}"]
        for name in names:
            for variant in labels:
                row = indexed.loc[(name, *variant, snr_db)]
                cells.append(f"{row['hausdorff_sum_m_mean']:.1f}; {row['f_score_mean']:.2f}")
        rows.append(cells)
    return markdown(header, rows)


STREET_SCORES = {  # heading: column, form
    "points": ("n_estimated", ".0f"),
    "F-score": ("f_score", ".2f"),
    "precision": ("precision", ".2f"),
    "recall": ("recall", ".2f"),
    "objects: F-score": ("objects_f_score", ".2f"),
    "GOSPA skill": ("gospa_skill", ".2f"),
    "velocity error [m/s]": ("velocity_error_mps", ".2f"),
    "velocity NMSE": ("velocity_nmse", ".1e"),
    "chamfer [m]": ("chamfer_m", ".2f"),
    "density": ("density", ".2f"),
    "SSIM": ("ssim", ".2f"),
}


def street_scores() -> str:
    """Other scores on the paper's streets at 10 dB."""
    table = summarise_scores(rows_of("paper").rows)
    table = table[table["snr_db"] == TOP_DB].set_index(["scenario", *VARIANT])
    names, labels = table.index.get_level_values(0).unique(), labels_of("paper")
    columns = [(name, *variant) for name in names for variant in labels]
    header = ["", *(f"{name} {code(label)}" for name in names for label in labels.values())]
    rows = [
        [heading, *(number(table.loc[column][f"{score}_mean"], form) for column in columns)]
        for heading, (score, form) in STREET_SCORES.items()
    ]
    return markdown(header, rows)


def efficiency() -> str:
    """Misses, and errors over the Cramér-Rao bound."""
    table = EfficiencyKind().summary(rows_of("efficiency").rows)
    gains_db = sorted(table["snr_gain_db"].unique())
    shown_db = [gain_db for gain_db in (20.0, 30.0, 40.0) if gain_db in gains_db]
    header = ["", *(f"missed at {gain_db:g} dB" for gain_db in (10, 15, 20, 25))]
    header += [f"{dimension} at {gain_db:g} dB" for gain_db in shown_db for dimension in DIMENSIONS]
    rows = []
    for variant, label in labels_of("efficiency").items():
        own = own_rows(table, variant).set_index("snr_gain_db")
        cells = [number(own["n_misses"][gain_db] / own["n_trials"][gain_db]) for gain_db in (10, 15, 20, 25)]
        cells += [number(own[f"ratio_{name}"][gain_db]) for gain_db in shown_db for name in DIMENSIONS]
        rows.append([code(label), *cells])
    return markdown(header, rows)


def resolution() -> str:
    """Shares of pairs told apart, over their distance in each dimension."""
    table = resolutions()
    cells = sorted(table["separation_cells"].unique())
    header = ["", "", *(f"{distance:g}" for distance in cells)]
    rows = []
    for dimension in DIMENSIONS:
        for variant, label in labels_of("resolution").items():
            own = own_rows(table[table["dimension"] == dimension], variant)
            shares = own.set_index("separation_cells")["resolved"]
            rows.append([dimension, code(label), *(number(shares[distance]) for distance in cells)])
    return markdown(header, rows, left=2)


def detectors() -> str:
    """Detectors on the street and at a clutter edge, and images behind them."""
    table = DetectionKind().summary(rows_of("detectors").rows)
    table = table[(table["pfa"] == 1e-3) & (table["snr_gain_db"] == table["snr_gain_db"].max())]
    street = table[table["scenario"] == "street"].set_index("detector")
    edge = table[table["scenario"] == "clutter-edge"].set_index("detector")
    rows = [
        [
            code(name),
            number(street["pd"][name]),
            *(f"{part['pfa_measured'][name]:.1e}" for part in (street, edge)),
            number(street["deviation_mean"][name]),
        ]
        for name in street.index
    ]
    header = [
        "",
        "P_d of cells",
        "P_fa of cells",
        "P_fa at a clutter edge",
        "deviation of `music2d` behind it",
    ]
    return markdown(header, rows)


def aperture() -> str:
    """Images of 8 x 8 and of 16 x 16 virtual elements."""
    table = summarise_scores(rows_of("aperture").rows).set_index(["scenario", *VARIANT, "snr_db"])
    labels, arrays = labels_of("aperture"), {"street-8x8": "8 x 8", "street": "16 x 16"}
    header = [
        "SNR [dB]",
        *(f"{array} {code(label)}" for label in labels.values() for array in arrays.values()),
    ]
    rows = []
    for snr_db in sorted(table.index.unique("snr_db")):
        found = [table.loc[(name, *variant, snr_db)] for variant in labels for name in arrays]
        cells = [f"{row['hausdorff_sum_m_mean']:.1f}; {row['f_score_mean']:.2f}" for row in found]
        rows.append([f"{snr_db:g}", *cells])
    return markdown(header, rows)


def looks() -> str:
    """Scenes for reporting that were looked at."""
    table = pd.read_csv(ROOT / "results" / "looks.csv", keep_default_na=False)
    rows = [
        [row["date"], code(row["suite"]), f"{row['first_seed']}-{row['last_seed']}", row["estimators"]]
        for row in table.to_dict("records")
    ]
    return markdown(["date", "suite", "seeds", "what"], rows, left=4)


STEPS = (  # the suite `printed` in its order
    "as printed",
    "exact threshold of `osca`",
    "+ power of all elements",
    "+ tapered maps",
    "+ order statistic along Doppler",
    "+ edge of the noise, `joint` pairing, subarrays of 10",
    "+ limits on dynamic range",
    "+ directions that the cell determines: `music2d`",
    "`fft4d`",
)


def printed() -> str:
    """Images from the print to the default."""
    return _steps(STEPS, (-20.0, -5.0, TOP_DB), {"street": "street", "street-coherent": "street-coherent"})


def transmitter() -> str:
    """Images with noise of the receivers and of the transmitter."""
    names = {"street": "noise of the receivers", "street-transmitter-noise": "of the transmitter"}
    return _steps((STEPS[0], *STEPS[-2:]), (-80.0, -45.0, -20.0, TOP_DB), names)


def _steps(chosen: Cells, snrs: Sequence[float], names: dict[str, str]) -> str:
    """Lay out steps of the suite `printed` at some SNRs, a column a scenario."""
    table = summarise_scores(rows_of("printed").rows).set_index([*VARIANT, "scenario", "snr_db"])
    rows = []
    for step, variant in zip(STEPS, labels_of("printed"), strict=True):
        for snr_db in snrs if step in chosen else ():
            found = [table.loc[[(*variant, name, snr_db)]].iloc[0] for name in names]
            rows.append([step if snr_db == snrs[0] else "", f"{snr_db:g}", *map(_five, found)])
    return markdown(["", "SNR [dB]", *names.values()], rows)


def _five(row: pd.Series) -> str:
    """Hausdorff sum, points, precision, recall and F-score."""
    shares = "".join(f", {row[f'{name}_mean']:.2f}" for name in ("precision", "recall", "f_score"))
    return f"{row['hausdorff_sum_m_mean']:.2f}, {row['n_estimated_mean']:.0f}{shares}"


@cache
def population_points() -> pd.DataFrame:
    """Time and error of each estimator over all scenes, from processor times of cells that were not alone."""
    records = rows_of("population").rows
    return summarise_points(records.assign(timing=True))


def pareto() -> str:
    """Time and Hausdorff sum over the scenes of the population; on the frontier in bold."""
    points = population_points().set_index([*VARIANT, "snr_db"])
    header = ["", *(f"{snr_db:g} dB: time [s]" for snr_db in snrs_db())]
    header += [f"{snr_db:g} dB: Hausdorff sum [m]" for snr_db in snrs_db()]
    rows = []
    for variant, label in competing("population").items():
        own = [points.loc[(*variant, snr_db)] for snr_db in snrs_db()]
        cells = [seconds(row["time_s"]) for row in own]
        for row in own:
            mean = row["hausdorff_sum_m_mean"]
            text = f"{mean:.1f} ± {row['hausdorff_sum_m_high'] - mean:.1f}"
            cells.append(f"**{text}**" if row["is_on_frontier"] else text)
        rows.append([code(label), *cells])
    return markdown(header, rows)


def peers() -> str:
    """Times beside those of other libraries (peers.py)."""
    table = pd.read_csv(ROOT / "results" / "reference" / "peers.csv", dtype=str)
    header = ["", "instead", "isacbench [s]", "instead [s]", "ratio"]
    instead = table["other"] + " (" + table["version"] + ")"
    rows = zip(table["work"], instead, table["own_s"], table["other_s"], table["ratio"], strict=True)
    return markdown(header, rows, left=2)


SETTINGS = ["pfa", "dynamic_range_db", "notch_mps"]


@cache
def drops(name: str) -> pd.DataFrame:
    """Summary of drops of drones, with what their estimators are set to."""
    table = DropsKind().summary(rows_of(name).rows)
    settings = pd.json_normalize(table["params"].map(json.loads).tolist())[SETTINGS]
    return pd.concat([table, settings], axis=1)


def _shares(row: pd.Series) -> list[str]:
    """Missed targets and false alarms in per cent, with intervals."""
    names = "missed_detection", "false_alarm_type1", "false_alarm_type2"
    return [
        "{:.1f} ({:.1f} to {:.1f})".format(*(100 * row[f"{name}{end}"] for end in ("", "_low", "_high")))
        for name in names
    ]


def uma_av() -> str:
    """Missed and false detections and accuracies at 52 dBm, and shares at 37 dBm."""
    header = ["", "missed [%]", "Type 1 [%]", "Type 2 [%]", "horizontal [m]", "vertical [m]"]
    header += ["radial velocity [m/s]", "time [s]", *(f"37 dBm: {name}" for name in header[1:4])]
    accuracies = {"horizontal_error_p90_m": ".2f", "vertical_error_p90_m": ".2f"}
    accuracies["radial_velocity_error_p90_mps"] = ".3f"
    rows = []
    for _, own in drops("uma-av").groupby(VARIANT, sort=False):
        high, low = (own[own["snr_db"] == snr_db].iloc[0] for snr_db in POWERS_DB)
        cells = [*_shares(high), *(number(high[name], form) for name, form in accuracies.items())]
        cells += [seconds(high["time_estimate_s_median"]), *_shares(low)]
        rows.append([code(high["estimator"]), *cells])
    return markdown(header, rows)


def uma_av_categories() -> str:
    """Limits of the categories of TS 22.137 that `nomp4d` keeps."""
    rows = rows_of("uma-av").rows
    *_, table = DropsKind().tables(rows[rows["estimator"] == "nomp4d"])
    return markdown(table.headings[1:], [texts[1:] for texts in table.texts])


def uma_av_clutter() -> str:
    """Missed and false detections among cars and people on the ground, with and without a notch."""
    header = ["", "`dynamic_range_db`", "`notch_mps`", "missed [%]", "Type 1 [%]", "Type 2 [%]"]
    rows = [
        [code(row["estimator"]), *(number(row[name], "g") for name in SETTINGS[1:]), *_shares(row)]
        for _, row in drops("uma-av-clutter").iterrows()
    ]
    return markdown(header, rows)


POWERS_DB = {0.0: "52 dBm", -15.0: "37 dBm"}
"""Offsets of the suites of drones, and what they stand for."""

PUBLISHED = {"5GNRad, one station": (0.238, 0.796), "5GNRad, 13 stations": (0.046, 0.920)}
"""False alarms of Type 2 and detection that NIST has published with arXiv 2604.02205."""


def uma_av_plane() -> ChartGroup:
    """Detection over false alarms of Type 2: a line through the thresholds of each detector."""
    lines, charts = lines_of(rows_of("uma-av").rows), []
    styles = {name: line.style for (name, _), line in lines.items()}
    others = drops("uma-av")
    both = pd.concat([drops("uma-av-thresholds"), others[others["estimator"].isin(["omp4d", "nomp4d"])]])
    for snr_db, title in POWERS_DB.items():
        part = both[both["snr_db"] == snr_db].sort_values("pfa")
        series = [
            Series(name, own["false_alarm_type2"], 1 - own["missed_detection"], style=styles[name])
            for name, own in part.groupby("estimator", sort=False)
        ]
        if not snr_db:
            series += [
                Series(name, [false], [found], mark="points", style=LineStyle("", "", symbol))
                for (name, (false, found)), symbol in zip(
                    PUBLISHED.items(), ["x", "diamond-open"], strict=True
                )
            ]
        axes = Axis("false alarm Type 2", limits=(-0.01, 0.6)), Axis("detected", limits=(0.6, 1.0))
        charts.append(Chart(title, *axes, series, [0.95]))
    return ChartGroup(
        "uma-av-plane", "100 drops of five drones; 5GNRad: 50 other drops", charts, 2, (4.0, 3.2)
    )


TABLES: dict[str, Callable[[], str]] = {
    "chosen": chosen,
    "over-snr": over_snr,
    "scores": scores,
    "objects": objects,
    "families": families,
    "conditions": conditions,
    "lone": lone,
    "places": places,
    "street": street,
    "street-scores": street_scores,
    "efficiency": efficiency,
    "resolution": resolution,
    "detectors": detectors,
    "printed": printed,
    "transmitter": transmitter,
    "aperture": aperture,
    "pareto": pareto,
    "pairs": pairs,
    "ranks": rank_example,
    "looks": looks,
    "peers": peers,
    "uma-av": uma_av,
    "uma-av-categories": uma_av_categories,
    "uma-av-clutter": uma_av_clutter,
}


def with_tables(text: str) -> str:
    """Replace the tables of a page by those that the rows give."""
    return MARKED.sub(
        lambda found: f"<!-- table {found[1]} -->\n\n{TABLES[found[1]]()}\n\n<!-- end -->", text
    )


def draw() -> None:
    """Draw the pictures that belong to the tables."""
    run, points = rows_of("population"), population_points()
    lines = lines_of(run.rows)
    groups = [
        pareto_charts(points[points["estimator"] != "empty"], "pareto-scenes", lines),
        replace(ranking_charts(ranking(TOP_DB)), stem="population-ranks"),
        *(replace(group, stem="population-ratios") for group in ratio_charts(with_ratios(run.rows), lines)),
        uma_av_plane(),
    ]
    save_figures(drawings_of(groups), ROOT / "docs" / "images")


if __name__ == "__main__":
    for page in PAGES:
        path = ROOT / page
        path.write_text(with_tables(path.read_text(encoding="utf-8")), encoding="utf-8")
    draw()
