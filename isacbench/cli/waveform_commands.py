"""Command on the transmitted waveform."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, cast

from typer import Option

from isacbench.bench.run.progress import progress_shown
from isacbench.cli.app import app, say
from isacbench.cli.options import AsJson, ScenarioName, Seed, require_names
from isacbench.cli.printing import print_json, print_table


@app.command("waveform")
def waveform_command(
    scenario: ScenarioName = "street",
    modulation: Annotated[
        list[str] | None, Option(metavar="NAME", help="qpsk, 16qam, 64qam or 256qam; repeats.")
    ] = None,
    frames: Annotated[int, Option(min=1, help="Frames whose peaks are measured.")] = 45,
    seed: Seed = 0,
    out: Annotated[Path | None, Option("-o", "--out", help="Folder for figures.")] = None,
    as_json: AsJson = False,
) -> None:
    """Measure the waveform of a scenario: times, bandwidth, peaks, bit rates."""
    require_names([scenario])
    from isacbench.choices import Modulation
    from isacbench.link.waveform.figures_of_merit import draw_papr_db, waveform_merits
    from isacbench.link.waveform.qam import BITS, bits_per_symbol
    from isacbench.link.waveform.resource_grid import draw_grid
    from isacbench.model.scenes.scenario import load_scenario
    from isacbench.report.texts.waveform_merits import describe_waveform, waveform_grids

    modulations = [cast("Modulation", name) for name in dict.fromkeys(modulation or BITS)]
    for name in modulations:
        bits_per_symbol(name)
    scene = load_scenario(scenario)
    system = scene.system
    merits = waveform_merits(system)
    papr_db = {}
    with progress_shown("peaks", "modulations") as show:
        for n_done, name in enumerate(modulations, start=1):
            papr_db[name] = draw_papr_db(system, name, frames, seed=seed)
            show(n_done, len(modulations))
    if as_json:
        print_json({"scenario": scene.name, **describe_waveform(system, merits, papr_db)})
    else:
        say(scene.name)
        for grid in waveform_grids(system, merits, papr_db):
            print_table(grid)
    if out is not None:
        from isacbench.report.figures.waveform_figures import draw_waveform

        paths = draw_waveform(out, scene.name, system, draw_grid(system, modulations[0], seed=seed), papr_db)
        if not as_json:
            for path in paths:
                say(str(path))
