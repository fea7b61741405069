"""The command line: parses, calls, prints. Everything heavy is imported inside the commands."""

from __future__ import annotations

import json
import math
import time
import traceback
import warnings
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, TextIO

import typer
from typer.core import TyperGroup

from isacbench import __version__
from isacbench.errors import InputError, InputWarning

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    import pandas as pd

    from isacbench.bench.runner import Progress
    from isacbench.bench.suite import Kind
    from isacbench.model.cloud import PointCloud
    from isacbench.model.region import Region
    from isacbench.report.aside import Aside
    from isacbench.report.tables import Grid

__all__ = ["app", "main"]

MAX_TABLE_WIDTH = 1000
GAPS_SHOWN = 10
"""Lines about missing cells; whoever misses more has not merged all parts yet."""

EXIT_USAGE = 2
EXIT_FAILED_CELLS = 3
EXIT_REGRESSION = 4
EXIT_NOT_COMPARABLE = 5
EXIT_INTERRUPTED = 130  # 128 + SIGINT, as shells have it


@contextmanager
def _plain_input_warnings() -> Iterator[None]:
    """Print warnings about the user's input as one line on stderr, without a line of source code."""
    with warnings.catch_warnings():
        show_with_source = warnings.showwarning

        def show(
            message: Warning | str,
            category: type[Warning],
            filename: str,
            lineno: int,
            file: TextIO | None = None,
            line: str | None = None,
        ) -> None:
            if issubclass(category, InputWarning):
                typer.echo(f"isacbench: warning: {message}", err=True)
            else:
                show_with_source(message, category, filename, lineno, file, line)

        warnings.showwarning = show
        yield


class _Group(TyperGroup):
    """Commands whose user's mistakes end in one line on stderr and exit code 2."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command that the arguments name."""
        try:
            with _plain_input_warnings():
                return super().invoke(ctx)
        except InputError as error:
            _fail(str(error), EXIT_USAGE)


app = typer.Typer(
    name="isacbench",
    cls=_Group,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="How accurate and how fast: a benchmark of radar imaging with 5G downlink signals.",
)


def main() -> None:
    """Run the command line."""
    app()


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"isacbench {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


EstimatorSpecs = Annotated[
    list[str] | None,
    typer.Option(
        "-e",
        "--estimator",
        metavar="NAME[param=value,...]",
        help="Estimator, instead of the suite's; repeats. A value [a,b] stands for each.",
    ),
]
PluginFiles = Annotated[
    list[Path] | None,
    typer.Option("--plugin", metavar="FILE.py", help="Local file with estimators or detectors; repeats."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON and nothing else.")]
OUT_HELP = "Folder, new or of the same run, which then goes on; default results/<suite>-<time>."
SEED_HELP = "Seed that all noise follows from."
ScenarioNames = Annotated[
    list[str] | None,
    typer.Option("-s", "--scenario", metavar="SCENARIO", help="Scenario, name or .toml path, likewise."),
]


@app.command()
def run(
    suite: Annotated[str, typer.Argument(metavar="[SUITE]", help="Suite by name or .toml path.")] = "paper",
    estimator: EstimatorSpecs = None,
    scenario: ScenarioNames = None,
    snr: Annotated[
        str | None, typer.Option("--snr", metavar="-30:20:5", help="SNRs in dB: a range, a list or one.")
    ] = None,
    trials: Annotated[
        int | None, typer.Option("-n", "--trials", metavar="TRIALS", min=1, help="Noise draws.")
    ] = None,
    seed: Annotated[int | None, typer.Option("--seed", metavar="SEED", min=0, help=SEED_HELP)] = None,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="DIR", help=OUT_HELP),
    ] = None,
    plugin: PluginFiles = None,
    jobs: Annotated[
        int | None,
        typer.Option("-j", "--jobs", metavar="JOBS", min=1, help="Worker processes; default 1."),
    ] = None,
    timeout: Annotated[
        float | None,
        typer.Option(
            "--timeout", metavar="SECONDS", help="Longest time of a cell; default 600, inf for none."
        ),
    ] = None,
    memory: Annotated[
        float | None,
        typer.Option("--memory", metavar="MIB", help="Most memory that a cell may add to its process."),
    ] = None,
    dask: Annotated[
        str | None,
        typer.Option("--dask", metavar="ADDRESS", help="Dask scheduler, instead of workers of this machine."),
    ] = None,
    shard: Annotated[
        str | None,
        typer.Option("--shard", metavar="k/n", help="Only part k of n; isacbench merge joins parts."),
    ] = None,
    rerun: Annotated[
        list[str] | None,
        typer.Option(
            "--rerun", metavar="failed|stale|all", help="Cells of an existing folder to run again; repeats."
        ),
    ] = None,
    mix_versions: Annotated[
        bool, typer.Option("--mix-versions", help="Keep rows that other versions made beside new ones.")
    ] = False,
) -> None:
    """Run a suite: estimate, score, tabulate and draw; go on with a run where its folder exists."""
    if dask is None:
        from isacbench.process_server import start_process_server

        start_process_server()  # which imports what workers need while this process imports the rest
    from isacbench.bench.folder import default_folder
    from isacbench.bench.guard import DEFAULT_TIMEOUT_S, Guard
    from isacbench.bench.plan import Shard
    from isacbench.bench.resume import parse_reruns
    from isacbench.bench.runner import Execution, run_suite
    from isacbench.bench.statuses import failed
    from isacbench.bench.suite import load_suite, parse_snr
    from isacbench.report.aside import Aside

    if out is None and (rerun or mix_versions):
        raise InputError(
            "--rerun and --mix-versions: allowed with -o DIR, the folder of the run to go on with"
        )
    execution = Execution(
        n_jobs=jobs or (1 if dask is None else None),
        guard=Guard(
            timeout_s=DEFAULT_TIMEOUT_S if timeout is None else None if timeout == math.inf else timeout,
            memory_mib=None if memory == math.inf else memory,
        ),
        dask=dask,
        shard=None if shard is None else Shard.parse(shard),
        rerun=parse_reruns(rerun or ()),
        mix_versions=mix_versions,
    )

    _register(plugin)
    wanted = load_suite(suite).replace(
        estimators=estimator,
        scenarios=scenario,
        snr_db=None if snr is None else parse_snr(snr),
        trials=trials,
        seed=seed,
    )
    folder = default_folder(wanted.name) if out is None else out
    with Aside() as aside:
        with _progress_bar(wanted.name) as show:

            def progress(n_done: int, n_cells: int) -> None:
                aside.get_ready()  # as soon as workers are busy, and this process is not
                show(n_done, n_cells)

            results = run_suite(wanted, folder, progress, execution)
        if not results.records.empty:
            _report(folder, results.records, results.suite.kind, aside)
    if results.interrupted:
        _fail(f"interrupted: the {len(results.records)} cells so far are in {folder}", EXIT_INTERRUPTED)
    lost = results.records[failed(results.records)]
    if not lost.empty:
        first = lost.iloc[0]
        _fail(
            f"{len(lost)} of {len(results.records)} cells failed, the first one {first['estimator']} on "
            f"{first['scenario']} at {first['snr_db']:g} dB, trial {first['trial']}: {first['status']}, "
            f"{first['reason']}",
            EXIT_FAILED_CELLS,
        )


@app.command()
def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a run.")],
    plugin: PluginFiles = None,
) -> None:
    """Redraw tables and figures of a run, without running again."""
    from isacbench.bench.store import read_results

    _register(plugin)
    results = read_results(folder)
    _report(folder, results.records, results.suite.kind)


@app.command()
def merge(
    folders: Annotated[
        list[Path], typer.Argument(metavar="DIR...", help="Folders of runs of one suite, such as its shards.")
    ],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="OUT", help="New folder for all of them.")],
    mix_versions: Annotated[
        bool, typer.Option("--mix-versions", help="Join rows of an estimator that several versions made.")
    ] = False,
    plugin: PluginFiles = None,
) -> None:
    """Join parts of a run: its shards, or runs of one suite with other estimators, SNRs or trials."""
    from isacbench.bench.merge import merge as merge_runs
    from isacbench.report.tables import estimator_labels

    _register(plugin)
    merged = merge_runs(folders, out, mix_versions)
    if not merged.records.empty:
        _report(out, merged.records, merged.kind)
    typer.echo(f"{out}: {len(merged.records)} of {merged.n_cells} cells")
    made = zip(merged.records["estimator"], merged.records["params"], strict=True)
    labels = estimator_labels([*made, *((gap.estimator, gap.params) for gap in merged.gaps)])
    for gap in merged.gaps[:GAPS_SHOWN]:
        trials = f"trial{'s' if len(gap.trials) > 1 else ''} {', '.join(map(str, gap.trials))}"
        label = labels[gap.estimator, gap.params]
        typer.echo(f"missing: {gap.n_cells} cells of {label} on {gap.scenario}, {trials}")
    if len(merged.gaps) > GAPS_SHOWN:
        typer.echo(f"missing: and of {len(merged.gaps) - GAPS_SHOWN} more")


@app.command()
def rescore(folder: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run.")]) -> None:
    """Score the clouds of a run again, without estimating: after a change of the metric, say."""
    from isacbench.bench.rescore import rescore as rescore_run

    rescored = rescore_run(folder)
    if not rescored.records.empty:
        _report(folder, rescored.records, rescored.kind)
    typer.echo(f"{folder}: {rescored.n_scored} rows scored again, {rescored.n_changed} of them differ")
    for change in rescored.changes:
        typer.echo(f"{change.column}: {change.n_rows} rows, by at most {change.largest:.6g}")


@app.command()
def compare(
    base: Annotated[Path, typer.Argument(metavar="BASE", help="Folder of the run to compare with.")],
    new: Annotated[Path, typer.Argument(metavar="NEW", help="Folder of the run to judge.")],
    tolerance: Annotated[
        list[str] | None,
        typer.Option(
            "--tolerance",
            metavar="NAME=5%",
            help="Tolerated change of a score, in % of BASE or in its unit; repeats. Always: deviation=5%.",
        ),
    ] = None,
    alpha: Annotated[
        float, typer.Option("--alpha", metavar="0.01", help="Probability of any false regression, at most.")
    ] = 0.01,
    plot: Annotated[
        Path | None,
        typer.Option("--plot", metavar="picture.png", help="Default NEW/figures/compare-<score>.png."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compare two runs: exit code 4 if a curve got worse, 5 if they cannot be compared."""
    from isacbench.bench.compare import compare as compare_runs
    from isacbench.bench.pairing import NotComparableError, read_run
    from isacbench.bench.tolerance import parse_tolerance
    from isacbench.report import comparison_tables as tables
    from isacbench.report.comparison import comparison_paths, draw_comparison_files

    tolerances = [parse_tolerance(text) for text in tolerance or []]
    try:
        found = compare_runs(read_run(base), read_run(new), tolerances, alpha)
    except NotComparableError as error:
        if as_json:
            _print_json({"comparable": False, "reasons": error.reasons})
            raise typer.Exit(EXIT_NOT_COMPARABLE) from error
        _fail("not comparable: " + "; ".join(error.reasons), EXIT_NOT_COMPARABLE)
    comparison_paths(found, new, plot)  # a wrong name is told before anything else
    if as_json:
        _print_json(tables.comparison_content(found))
    else:
        typer.echo(f"base {found.base}: isacbench {found.base_version}")
        typer.echo(f"new  {found.new}: isacbench {found.new_version}")
        for grid in tables.comparison_grids(found):
            _print_grid(grid)
        for line in tables.comparison_lines(found):
            typer.echo(line)
    if plot is not None or not as_json:
        figures = draw_comparison_files(found, new, plot)
        if figures and not as_json:
            typer.echo(f"figures: {', '.join(map(str, figures))}")
    if not as_json:
        typer.echo(tables.comparison_summary(found))
    if found.is_regression:
        raise typer.Exit(EXIT_REGRESSION)


@app.command("list")
def list_(as_json: AsJson = False, plugin: PluginFiles = None) -> None:
    """List estimators, detectors, scenarios and suites."""
    from isacbench.bench.catalogue import catalogue

    _register(plugin)
    content = catalogue()
    if as_json:
        _print_json(content)
        return
    for section, entries in content.items():
        typer.echo(f"{section}:")
        for entry in entries:
            typer.echo(f"  {entry['name']:<16} {entry['description']}")
            for name, parameter in entry.get("parameters", {}).items():
                default = f" = {json.dumps(parameter['default'])}" if "default" in parameter else ""
                typer.echo(f"      {name}: {parameter['type']}{default}")


@app.command()
def image(
    scenario: Annotated[
        str, typer.Option("-s", "--scenario", metavar="SCENARIO", help="Scenario, name or .toml path.")
    ] = "street",
    estimator: Annotated[
        str, typer.Option("-e", "--estimator", metavar="NAME[param=value,...]", help="Estimator.")
    ] = "music2d",
    snr: Annotated[str, typer.Option("--snr", metavar="DB", help="SNR in dB.")] = "10",
    trial: Annotated[int, typer.Option("--trial", metavar="TRIAL", min=0, help="Which noise draw.")] = 0,
    seed: Annotated[int, typer.Option("--seed", metavar="SEED", min=0, help=SEED_HELP)] = 0,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", metavar="cloud.csv|.ply|.mat|.npy", help="Write the cloud.")
    ] = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="picture.png", help="Draw the cloud beside the truth.")
    ] = None,
    plugin: PluginFiles = None,
) -> None:
    """Take one image, score it, and write or draw its cloud."""
    from isacbench.bench.runner import estimate_cloud
    from isacbench.metrics.score import score
    from isacbench.model.cloud_io import write_cloud
    from isacbench.model.echo import observe
    from isacbench.model.scenario import load_scenario
    from isacbench.registry import build_estimator

    if plot is not None and plot.suffix.lower() not in (".png", ".pdf", ".svg"):
        raise InputError(f"{plot}: a picture takes the extension .png, .pdf or .svg")
    _register(plugin)
    scene, imager, snr_db = load_scenario(scenario), build_estimator(estimator), _one_snr(snr)
    observation = observe(scene, snr_db, trial, seed)
    start = time.perf_counter()
    try:
        cloud = estimate_cloud(imager, observation, scene.truth)
    except InputError:
        raise
    except Exception as error:
        traceback.print_exc()
        _fail(f"{estimator} failed: {type(error).__name__}: {error}", EXIT_FAILED_CELLS)
    elapsed_s = time.perf_counter() - start
    title = f"{scene.name}, {estimator}, {snr_db:g} dB"
    if out is not None:
        write_cloud(cloud, out)
    if plot is not None:
        from isacbench.report.figures import draw_image

        draw_image(plot, observation, scene.truth, cloud, title)
    typer.echo(f"{title}: {len(cloud)} points in {1e3 * elapsed_s:.1f} ms")
    if len(scene.truth):  # a scene of noise alone can be looked at, not scored
        velocity_bin_mps = scene.system.velocity_bin_mps
        _print_scores(score(scene.truth, cloud, region=scene.region, velocity_bin_mps=velocity_bin_mps))


@app.command()
def check(
    package_or_file: Annotated[
        str, typer.Argument(metavar="PACKAGE_OR_FILE", help="Package, .py file, or registered name.")
    ],
    as_json: AsJson = False,
    plugin: PluginFiles = None,
) -> None:
    """Put estimators and detectors through the contract, and say what to mend."""
    from isacbench.conformance import find_plugins
    from isacbench.conformance.guarded import check_guarded
    from isacbench.report.conformance import describe_checks, print_checks

    _register(plugin)
    found = {(kind, name): check_guarded(kind, name) for kind, name in find_plugins(package_or_file)}
    if as_json:
        _print_json(describe_checks(found))
    else:
        print_checks(found)
    if any(finding.status == "failed" for findings in found.values() for finding in findings):
        raise typer.Exit(EXIT_FAILED_CELLS)


@app.command()
def score(
    truth: Annotated[
        str, typer.Argument(metavar="TRUTH", help="Cloud file, or a scenario by name or .toml path.")
    ],
    cloud: Annotated[
        Path, typer.Argument(metavar="CLOUD", help="Cloud file: .csv, .npy, .npz, .mat or .ply.")
    ],
    metric: Annotated[str, typer.Option("--metric", metavar="METRIC", help="paper or repository.")] = "paper",
    as_json: AsJson = False,
) -> None:
    """Score a cloud against the truth."""
    from isacbench.metrics.score import score as score_clouds
    from isacbench.model.cloud_io import read_cloud

    points, region, velocity_bin_mps = _truth(truth)
    scores = score_clouds(points, read_cloud(cloud), metric, region=region, velocity_bin_mps=velocity_bin_mps)
    if as_json:
        _print_json(scores)
    else:
        _print_scores(scores)


def _register(plugin_files: list[Path] | None) -> None:
    """Register local plugin files."""
    from isacbench.entries import load_plugin_file

    for path in plugin_files or ():
        load_plugin_file(path)


def _one_snr(text: str) -> float:
    """Parse a single SNR."""
    from isacbench.bench.suite import parse_snr

    values = parse_snr(text)
    if len(values) != 1:
        raise InputError(f"SNR {text!r}: allowed is one number, an image has one SNR")
    return values[0]


def _truth(name_or_path: str) -> tuple[PointCloud, Region | None, float | None]:
    """Truth from a cloud file, or from a scenario with its region and velocity bin."""
    from isacbench.model.cloud_io import read_cloud
    from isacbench.model.scenario import load_scenario

    region, velocity_bin_mps = None, None
    if Path(name_or_path).suffix in ("", ".toml"):
        scenario = load_scenario(name_or_path)
        points, region = scenario.truth, scenario.region
        velocity_bin_mps = scenario.system.velocity_bin_mps
    else:
        points = read_cloud(name_or_path)
    if not len(points):
        raise InputError(f"{name_or_path}: the truth has no points; allowed is at least one")
    return points, region, velocity_bin_mps


def _report(folder: Path, records: pd.DataFrame, kind: Kind, aside: Aside | None = None) -> None:
    """Write and print the tables of a run, and draw its figures."""
    from isacbench.report.aside import Aside
    from isacbench.report.kinds import TABLES, write_tables

    for grid in TABLES[kind].grids(records):
        _print_grid(grid)
    tables = write_tables(folder, records, kind)
    with Aside() if aside is None else nullcontext(aside) as hand:
        figures = hand.draw_run(folder)
    typer.echo(f"{folder}: {', '.join(path.name for path in [*tables, *figures])}")


def _print_grid(grid: Grid) -> None:
    """Print a table, in lines longer than the terminal rather than with cropped numbers."""
    from rich.console import Console

    from isacbench.report.tables import rich_table

    table = rich_table(grid)
    width = max(Console().width, Console(width=MAX_TABLE_WIDTH).measure(table).maximum)
    Console(width=width).print(table)


@contextmanager
def _progress_bar(title: str) -> Iterator[Progress]:
    """Bar with the time left on stderr; silent where that is no terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        task = bar.add_task(title, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _print_scores(scores: Mapping[str, float]) -> None:
    for name, value in scores.items():
        typer.echo(f"  {name:<16} {value:.6g}")


def _print_json(content: object) -> None:
    typer.echo(json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False))


def _fail(message: str, code: int) -> NoReturn:
    typer.echo(f"isacbench: {message}", err=True)
    raise typer.Exit(code)
