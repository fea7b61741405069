"""Pages of runs, rankings, comparisons and leaderboards: one HTML file each, with no way out of the page."""

import base64
import gzip
import hashlib
import html
import json
import re
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from isacbench.bench.compare.comparison import Comparison
from isacbench.bench.store.run import Run
from isacbench.bench.store.run_folder import atomic_write
from isacbench.errors import InputError
from isacbench.report.diagnoses import diagnosed_maps
from isacbench.report.html.joined_runs import join_runs
from isacbench.report.html.page_content import DEFAULT_METRIC, compared_content, page_content

RUN_PAGE = "report.html"
RANK_PAGE = "rank.html"
LEADERBOARD_PAGE = "leaderboard.html"
COMPARISON_PAGES = {False: "compare.html", True: "between.html"}
"""Name of the page of a comparison of runs, and of one of two estimators."""

SCRIPTS = (
    *("data", "elements", "figures", "tables", "clouds", "filters"),
    *("overview", "curves", "images", "maps", "scenes", "time", "studies", "comparison", "all_rows"),
    *("views", "start"),
)
"""Parts of the page's script, in the order in which they are joined."""


def write_run_page(run: Run) -> Path:
    """Write the page of a run, ``report.html``, into its folder.

    Maps and spectra are computed anew; a diagnosis that fails costs its own with a warning.
    """
    name = run.folder.resolve().name
    content, clouds = page_content(join_runs([run.changed(label=name)]))
    content["maps"] = diagnosed_maps(run)
    return _write(run.folder / RUN_PAGE, f"{name} - isacbench", content, clouds)


def write_rank_page(run: Run, metric: str | None = None) -> Path:
    """Write the page of a ranking, ``rank.html``, into the folder of its run."""
    name = run.folder.resolve().name
    content, clouds = page_content(join_runs([run.changed(label=name)]), metric)
    return _write(run.folder / RANK_PAGE, f"{name} ranked - isacbench", content, clouds)


def write_comparison_page(comparison: Comparison, compared: Sequence[Run]) -> Path:
    """Write the page of a comparison of two runs, or of two estimators of one, into the folder of the last.

    It is ``compare.html``, of two estimators of one run ``between.html``.
    """
    is_between = comparison.between is not None
    names = names_of([run.folder for run in compared])
    if not is_between and len(set(names)) < 2:
        names = ["base", "new"]
    runs = [run.changed(label=name) for run, name in zip(compared, names, strict=True)]
    joined = join_runs(runs, rename_all=True)
    described, is_shown = compared_content(comparison, joined)
    metric = comparison.tolerances[0].metric if comparison.tolerances else DEFAULT_METRIC
    content, clouds = page_content(joined, metric, is_shown)
    content["comparison"] = described
    path = compared[-1].folder / COMPARISON_PAGES[is_between]
    return _write(path, f"{' and '.join(names)} compared - isacbench", content, clouds)


def write_leaderboard(runs: Sequence[Run], out: Path) -> Path:
    """Write one HTML page of several runs of one suite, with the same seed, metric and scenes.

    SNRs and trials that not all of them have are left out.
    """
    folders = [run.folder for run in runs]
    if len({folder.resolve() for folder in folders}) < len(folders):
        raise InputError("a folder is given twice; give different runs")
    named = [run.changed(label=name) for run, name in zip(runs, names_of(folders), strict=True)]
    joined = join_runs(named, only_common=True)
    content, clouds = page_content(joined)
    return _write(out, f"{joined.table.manifest['suite']['name']}: leaderboard - isacbench", content, clouds)


def names_of(folders: Sequence[Path]) -> list[str]:
    """Name folders by their last part, or by their whole path where two share it.

    Examples
    --------
    >>> names_of([Path("mine/new"), Path("old")]), names_of([Path("a/run"), Path("b/run")])
    (['new', 'old'], ['a/run', 'b/run'])
    """
    short = [folder.resolve().name for folder in folders]
    return short if len(set(short)) == len(short) else [str(folder) for folder in folders]


def _write(path: Path, title: str, content: dict[str, Any], clouds: bytes) -> Path:
    """Write a page, in place of an older one.

    It loads nothing, and runs two scripts: its own and that of plotly, whose digests its
    Content-Security-Policy names.
    """
    own = "\n".join(_asset(f"{name}.js") for name in SCRIPTS)
    packed_plotly, plotly_digest = _plotly()
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    replaced = {
        "policy": f"default-src 'none'; script-src {_digest(own)} {plotly_digest}; "
        "style-src 'unsafe-inline'; img-src data: blob:; base-uri 'none'; form-action 'none'",
        "title": html.escape(title),
        "style": _asset("page.css"),
        "content": _packed(text.encode()),
        "clouds": _packed(clouds),
        "plotly": packed_plotly,
        "script": own,
    }
    page = re.sub(r"\{\{(\w+)\}\}", lambda match: replaced[match[1]], _asset("page.html"))
    with atomic_write(path, afterwards="") as temporary:
        temporary.write_text(page, encoding="utf-8", newline="\n")
    return path


@cache
def _asset(name: str) -> str:
    return (files(__package__) / "page" / name).read_text(encoding="utf-8")


@cache
def _plotly() -> tuple[str, str]:
    """Script of plotly, packed, and its digest."""
    script = (files("plotly") / "package_data" / "plotly.min.js").read_text(encoding="utf-8")
    return _packed(script.encode()), _digest(script)


def _digest(script: str) -> str:
    """Digest of a script as a Content-Security-Policy writes it."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"


def _packed(content: bytes) -> str:
    """Compress bytes with gzip and write them as text."""
    return base64.b64encode(gzip.compress(content, 4, mtime=0)).decode()
