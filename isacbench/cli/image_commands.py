"""Commands on one scenario and its image: take, score, simulate, plan, write the scene."""

from __future__ import annotations

import math
import time
import traceback
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option
from typer.core import TyperCommand

import isacbench
from isacbench.bench.run.progress import progress_shown
from isacbench.cli import options as opt
from isacbench.cli.app import Exit, app, fail, print_json, print_scores, print_tables, say, say_lines
from isacbench.errors import InputError, unknown_name
from isacbench.files.checked_files import require_picture
from isacbench.files.escaping import file_stems, plural

if TYPE_CHECKING:
    import numpy as np

Precision = Annotated[str, Option(metavar="single|double", help="Precision of the recorded frame.")]
DEFAULT_SNR = "10"

REPEATED_S = 1.0
"""Longest first call that is repeated: of longer ones imports are a small part."""


OWN_PICTURE = Path("?")
"""Value of ``--plot`` without a file: the picture is named after scenario and estimator."""


class _OptionalPicture(TyperCommand):
    """Command whose option ``--plot`` may stand without a file."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Give a lone ``--plot`` its value."""
        followers = [*args[1:], "-"]
        given = [
            f"--plot={OWN_PICTURE}" if one == "--plot" and follower.startswith("-") else one
            for one, follower in zip(args, followers, strict=False)
        ]
        return super().parse_args(ctx, given)


@app.command("image", cls=_OptionalPicture)
def image_command(
    scenario: opt.ScenarioName = "street",
    estimator: opt.EstimatorName = "music2d",
    cube: Annotated[Path | None, Option(help="Recorded frame: .npy, .npz, .mat, .h5 or .zarr.")] = None,
    transmitted: Annotated[Path | None, Option(help="Transmitted grid, which divides the cube.")] = None,
    ascending: Annotated[
        str | None, Option(metavar="±u,±w", help="Order of elements; default -u,-w.")
    ] = None,
    snr: Annotated[str | None, Option(help="SNR in dB, or inf; default 10, none with a cube.")] = None,
    trial: Annotated[int | None, Option(min=0, help="Number of the noise draw.")] = None,
    seed: opt.OptionalSeed = None,
    sensing: Annotated[str | None, Option(metavar="all|prs", help="Sensed resource elements.")] = None,
    modulation: Annotated[str | None, Option(help="qpsk, 16qam, 64qam or 256qam.")] = None,
    division: Annotated[str | None, Option(help="reciprocal, matched or wiener.")] = None,
    out: Annotated[Path | None, opt.out_option(help="Cloud: .csv, .ply, .mat or .npy.")] = None,
    plot: Annotated[Path | None, Option(help="Picture: .png, .pdf, .svg, or no name.")] = None,
    plugin: opt.PluginFiles = None,
) -> None:
    """Take one image of a simulated or a recorded frame, and score, write or draw its cloud."""
    if plot is not None and plot != OWN_PICTURE:
        require_picture(plot)
    if out is not None:
        from isacbench.model.cloud_files.point_files import require_writable

        require_writable(out)
    for option, value in (("--transmitted", transmitted), ("--ascending", ascending)):
        if cube is None and value is not None:
            raise InputError(f"{option} needs --cube FILE")
    if cube is not None and (trial, seed, modulation) != (None, None, None):
        raise InputError("--trial, --seed and --modulation cannot be combined with --cube")
    if cube is not None and snr is not None and division != "wiener":
        raise InputError("with --cube, --snr needs --division wiener")
    choices = {"sensing": sensing, "modulation": modulation, "division": division}
    signal: dict[str, Any] = {name: choice for name, choice in choices.items() if choice is not None}
    opt.register(plugin)
    opt.require_names([scenario], [estimator])
    from isacbench.bench.cells.images import estimate_cloud, image_reference
    from isacbench.cores import one_blas_thread
    from isacbench.cubes.frame import summarise_frame
    from isacbench.instrument.remarks import Remarks
    from isacbench.plugins.contracts import is_reference
    from isacbench.plugins.registry import build_estimator

    scene, imager = isacbench.load_scenario(scenario), build_estimator(estimator)
    if cube is None:
        snr_db = _one_snr(snr or DEFAULT_SNR)
        title = f"{scene.name}, {estimator}, {snr_db:g} dB"
        observation = isacbench.observe(scene, snr_db, trial or 0, seed or 0, **signal)
    else:
        title = f"{cube.name}, {scene.name}, {estimator}"
        known_snr_db = None if snr is None else _one_snr(snr)
        if ascending is not None:
            along_u, _, along_w = ascending.partition(",")
            scene = replace(scene, array=replace(scene.array, ascending=(along_u, along_w)))
        observation = isacbench.observe_cube(cube, scene, transmitted, snr_db=known_snr_db, **signal)
        say(*(f"{cube.name}: {sentence}" for sentence in summarise_frame(observation).sentences()))
    title = ", ".join([title, *signal.values()])
    take = one_blas_thread()(partial(estimate_cloud, imager, observation, scene.truth))
    try:
        with Remarks() as remarks:
            cloud, first_s = _timed(take)
        # A recorded frame is read by the first call.
        again_s = _timed(take)[1] if cube is None and first_s < REPEATED_S else None
    except InputError:
        raise
    except Exception as error:
        traceback.print_exc()
        fail(f"{estimator} failed: {type(error).__name__}: {error}", Exit.FAILED_CELLS)
    if out is not None:
        cloud.write(out)
    if plot is not None:
        from isacbench.report.clouds import plot_clouds

        if plot == OWN_PICTURE:
            (stem,) = file_stems([f"{scene.name} {estimator}"]).values()
            plot = Path(f"{stem}.png")
            say(f"picture: {plot}")
        plot_clouds(scene.truth, cloud, region=scene.region, radius_m=scene.radius_m, title=title, out=plot)
    took = f"{1e3 * first_s:.1f} ms"
    if again_s is None:
        took += f", {'' if cube is None else 'reading, '}imports and tables included"
    else:  # which is what runs measure
        took = f"{1e3 * again_s:.1f} ms (the first call, with imports and tables: {took})"
    say(f"{title}: {plural(len(cloud), 'point')} in {took}")
    say(*remarks.sentences())
    if not len(scene.truth):  # a scene of noise alone can be looked at, not scored
        return
    if is_reference(imager):
        image = image_reference(imager, scene)
        say("scores: mean ± spread over its realisations; the cloud is the one nearest to the mean")
        print_scores(image.scores, image.spreads)
    else:
        print_scores(isacbench.score(scene, cloud))


@app.command("simulate")
def simulate_command(
    out: Annotated[Path, opt.out_option(help="New file: .npy or .zarr.")],
    scenario: opt.ScenarioName = "street",
    snr: Annotated[str, Option(metavar="DB|inf", help="SNR in dB.")] = DEFAULT_SNR,
    trial: Annotated[int, Option(min=0, help="Number of the noise draw.")] = 0,
    seed: opt.Seed = 0,
    precision: Precision = "single",
) -> None:
    """Write the full frame of a scenario; its image is that of the same SNR, trial and seed."""
    opt.require_names([scenario])
    from isacbench.cubes import write_cube
    from isacbench.cubes.writing import FrameSimulator

    dtype = _dtype(precision)
    frame = FrameSimulator(isacbench.load_scenario(scenario), _one_snr(snr), trial, seed)
    start = time.perf_counter()
    with progress_shown(out.name, "subcarriers") as show:
        write_cube(out, frame.shape, frame.blocks(), dtype, show)
    size = " x ".join(map(str, frame.shape))
    n_bytes = math.prod(frame.shape) * dtype.itemsize
    say(f"{out}: {size}, {dtype}, {n_bytes / 1e6:.0f} MB in {time.perf_counter() - start:.1f} s")


@app.command("plan")
def plan_command(
    scenario: opt.ScenarioName = "street",
    estimator: opt.EstimatorName = "music2d",
    precision: Precision = "single",
    as_json: opt.AsJson = False,
    plugin: opt.PluginFiles = None,
) -> None:
    """Compare the cost of an image of a recorded frame with that of the full 4-D chain."""
    opt.register(plugin)
    opt.require_names([scenario], [estimator])
    from isacbench.charts import text_table
    from isacbench.cubes.image_cost import HEADER, cost_rows, image_cost
    from isacbench.plugins.registry import build_estimator

    scene = isacbench.load_scenario(scenario)
    cost = image_cost(scene, build_estimator(estimator), _dtype(precision))
    if as_json:
        print_json(cost)
        return
    title = f"{scene.name}, {estimator}: recorded frame, compared with the full 4-D chain"
    print_tables(text_table(title, HEADER, cost_rows(cost)))
    say("Operations of a matrix product (partial DFT) take a sixteenth of the time of those of an FFT.")


@app.command("scene")
def scene_command(
    scenario: Annotated[str, Argument(metavar="SCENARIO", help="Name, .toml path or family[seed=7,...].")],
    out: Annotated[Path | None, opt.out_option(help="New .toml file; default: print.")] = None,
) -> None:
    """Write a scenario as a TOML file that can be edited."""
    opt.require_names([scenario])
    from isacbench.model.scenes.editable_scenes import scene_toml, write_scene

    if out is None:
        say_lines(scene_toml(scenario))
        return
    write_scene(scenario, out)
    say(f"{out}: scenario {out.stem!r}; the name seeds its noise and the errors of its array")


@app.command("score")
def score_command(
    truth: Annotated[str, Argument(help="Cloud file, or a scenario by name or .toml path.")],
    cloud: Annotated[Path, Argument(help="Cloud file: .csv, .npy, .npz, .mat or .ply.")],
    metric: Annotated[str, opt.metric_option(help="Metric.")] = "paper",
    plugin: opt.PluginFiles = None,
    as_json: opt.AsJson = False,
) -> None:
    """Score a cloud against the truth."""
    opt.register(plugin)
    opt.require_names(metrics=[metric])
    from isacbench.model.scenes.scene_families import is_family_spec

    if is_family_spec(truth) or Path(truth).suffix in ("", ".toml"):
        known: isacbench.Scenario | isacbench.PointCloud = isacbench.load_scenario(truth)
    else:
        known = isacbench.PointCloud.read(truth)
        if not len(known):
            raise InputError(f"{truth}: the truth has no points; allowed is at least one")
    scores = isacbench.score(known, isacbench.PointCloud.read(cloud), metric=metric)
    if as_json:
        print_json({name: None if math.isnan(value) else value for name, value in scores.items()})
    else:
        print_scores(scores)


def _timed(take: Callable[[], isacbench.PointCloud]) -> tuple[isacbench.PointCloud, float]:
    """Take an image and measure the processor time in s."""
    start = time.process_time()
    cloud = take()
    return cloud, time.process_time() - start


def _dtype(precision: str) -> np.dtype[Any]:
    """Translate the precision of a frame."""
    import numpy as np

    dtypes = {"single": "complex64", "double": "complex128"}
    if precision not in dtypes:
        raise unknown_name("precision", precision, dtypes)
    return np.dtype(dtypes[precision])


def _one_snr(text: str) -> float:
    """Parse a single SNR in dB; `inf` means no noise."""
    from isacbench.bench.suites.suite import parse_snr

    if text.strip() == "inf":
        return math.inf
    values = parse_snr(text)
    if len(values) != 1:
        raise InputError(f"--snr {text!r}: allowed is one number")
    return values[0]
