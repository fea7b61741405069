"""Commands on one image: take it, score it."""

from __future__ import annotations

import time
import traceback
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from isacbench.cli.app import EXIT_FAILED_CELLS, app, fail
from isacbench.cli.options import SEED_HELP, AsJson, PluginFiles, register
from isacbench.cli.printing import print_json, print_scores
from isacbench.errors import InputError

if TYPE_CHECKING:
    from isacbench.model.cloud import PointCloud
    from isacbench.model.region import Region

__all__ = ["image", "score"]


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
    register(plugin)
    scene, imager, snr_db = load_scenario(scenario), build_estimator(estimator), _one_snr(snr)
    observation = observe(scene, snr_db, trial, seed)
    start = time.perf_counter()
    try:
        cloud = estimate_cloud(imager, observation, scene.truth)
    except InputError:
        raise
    except Exception as error:
        traceback.print_exc()
        fail(f"{estimator} failed: {type(error).__name__}: {error}", EXIT_FAILED_CELLS)
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
        print_scores(score(scene.truth, cloud, region=scene.region, velocity_bin_mps=velocity_bin_mps))


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
        print_json(scores)
    else:
        print_scores(scores)


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
