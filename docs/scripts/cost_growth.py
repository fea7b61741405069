"""Vary one size of a scene at a time, measure what an image costs, and write it into docs/cost-growth.md.

One BLAS thread, warm, medians; memory is what echo, noise and image allocate at
their peak. Exponents are slopes of a straight line through the logarithms.

    python docs/scripts/cost_growth.py
"""

from __future__ import annotations

import argparse
import statistics
import tracemalloc
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time

import numpy as np
from matplotlib.axes import Axes
from threadpoolctl import threadpool_limits

from isacbench import Scenario, get_estimator, load_scenario
from isacbench.model.array import VirtualArray
from isacbench.model.echo import Simulator
from isacbench.model.region import Region
from isacbench.model.scene import Scatterers
from isacbench.report.drawing.style import new_figure, save, styled

DOCS = Path(__file__).resolve().parents[1]
PAGE, FIGURE = DOCS / "cost-growth.md", DOCS / "images" / "cost-growth.png"
START, END = "<!-- cost growth: written by docs/scripts/cost_growth.py -->", "<!-- end -->"

STEPS = ("echo", "noise", "image")
SNR_DB = 10.0
SEED = 1


@dataclass(frozen=True)
class Series:
    """Scenes that differ in one size: its name, its values, and the scene and the SNR of a value."""

    title: str
    label: str
    values: tuple[float, ...]
    scene: Callable[[float], Scenario]
    snr_db: Callable[[float], float] = lambda value: SNR_DB
    logarithmic: bool = True


@dataclass(frozen=True)
class Cost:
    """Seconds of each step, and memory at the peak in MiB."""

    time_s: dict[str, float]
    memory_mib: float


def main() -> None:
    """Measure, draw and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("-e", "--estimator", default="music2d")
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    with threadpool_limits(limits=1):
        measured = [
            (series, [measure(series, value, options.estimator, options.repeats) for value in series.values])
            for series in all_series()
        ]
    draw(measured)
    write(table(measured))


def all_series() -> Iterator[Series]:
    """Every size, one at a time, from the street with all its objects."""
    street = load_scenario("street")

    def with_subcarriers(n: float) -> Scenario:
        return replace(street, system=replace(street.system, n_subcarriers=int(n)))

    def with_symbols(n: float) -> Scenario:
        return replace(street, system=replace(street.system, n_symbols=int(n)))

    yield Series(
        "subcarriers, and range bins",
        "subcarriers",
        (512, 1024, 2048, 4096, 8192),
        with_subcarriers,
    )
    yield Series("symbols, and Doppler bins", "symbols", (56, 112, 224, 448, 896), with_symbols)
    yield Series(
        "resource elements behind the same gate",
        "subcarriers x symbols",
        tuple(224 * 2048 * 4.0**k for k in (-2, -1, 0, 1, 2)),
        lambda n: same_gate(street, np.sqrt(n / (224 * 2048))),
    )
    yield Series(
        "array", "virtual elements", (16, 64, 256, 1024), lambda n: replace(street, array=square_array(n))
    )
    yield Series(
        "scatterers", "scatterers", (32, 128, 512, 2048), lambda n: with_random_scatterers(street, int(n))
    )
    yield Series("region", "depth in m", (5, 10, 20, 40, 80), lambda depth_m: with_depth(street, depth_m))
    yield Series(
        "SNR",
        "dB",
        (-30, -20, -10, 0, 10, 20, 30),
        lambda _: street,
        lambda snr_db: snr_db,
        logarithmic=False,
    )


def same_gate(street: Scenario, factor: float) -> Scenario:
    """Street with more subcarriers in the same band and more symbols, speeds and Doppler bins scaled alike.

    Subcarriers closer by a factor lengthen symbols by it, and as many more
    symbols lengthen the frame by its square: so do all speeds shrink.
    """
    system = replace(
        street.system,
        n_subcarriers=round(street.system.n_subcarriers * factor),
        n_symbols=round(street.system.n_symbols * factor),
        subcarrier_spacing_hz=street.system.subcarrier_spacing_hz / factor,
    )
    slower = system.velocity_bin_mps / street.system.velocity_bin_mps
    slowest_mps, fastest_mps = street.region.speed_mps
    return replace(
        street,
        system=system,
        region=replace(street.region, speed_mps=(slower * slowest_mps, slower * fastest_mps)),
        scatterers=replace(street.scatterers, velocity=slower * street.scatterers.velocity),
    )


def square_array(n_elements: float) -> VirtualArray:
    """Array of so many virtual elements, from two by two transmitters."""
    side = round(np.sqrt(n_elements)) // 2
    return VirtualArray((2, 2), (side, side), side, 1)


def with_random_scatterers(street: Scenario, n: int) -> Scenario:
    """Region of the street with scatterers anywhere in it, each with a speed of its own."""
    rng = np.random.default_rng(SEED)
    region = street.region
    return replace(
        street,
        scatterers=Scatterers(
            rng.uniform(region.lower_m, region.upper_m, (n, 3)),
            rng.uniform(*region.speed_mps, n),
            np.ones(n),
            rng.uniform(0, 2 * np.pi, n),
        ),
    )


def with_depth(street: Scenario, depth_m: float) -> Scenario:
    """Street whose region is so deep, with scatterers at the street's density in it."""
    region = Region(street.region.x_m, (20.0 - depth_m, 20.0), street.region.z_m, street.region.speed_mps)
    n = round(len(street.scatterers) * depth_m / 20)
    return with_random_scatterers(replace(street, region=region, scatterers=NOTHING), n)


NOTHING = Scatterers(np.empty((0, 3)), np.empty(0), np.empty(0))


def measure(series: Series, value: float, estimator: str, repeats: int) -> Cost:
    """Median times of a scene, and its memory in a run of its own."""
    scenario, snr_db = series.scene(value), series.snr_db(value)
    imager = get_estimator(estimator)

    def once() -> dict[str, float]:
        simulator = Simulator(scenario)
        ticks = [process_time()]
        simulator.clean  # noqa: B018 - computed when first asked for
        ticks.append(process_time())
        observation = simulator.observe(snr_db)
        ticks.append(process_time())
        imager.estimate(observation)
        ticks.append(process_time())
        return dict(zip(STEPS, np.diff(ticks), strict=True))

    once()
    times = [once() for _ in range(repeats)]
    tracemalloc.start()
    once()
    memory_mib = tracemalloc.get_traced_memory()[1] / 2**20
    tracemalloc.stop()
    print(f"{series.title}: {value:g}", flush=True)
    return Cost({step: statistics.median(time[step] for time in times) for step in STEPS}, memory_mib)


def exponent(values: tuple[float, ...], costs: list[float]) -> float:
    """Slope of a straight line through the logarithms."""
    return float(np.polyfit(np.log(values), np.log(costs), 1)[0])


def lines_of(costs: list[Cost]) -> dict[str, list[float]]:
    """Times in ms of every step and memory in MiB, over the values of a series."""
    lines = {step: [1e3 * cost.time_s[step] for cost in costs] for step in STEPS}
    return {**lines, "memory": [cost.memory_mib for cost in costs]}


def draw(measured: list[tuple[Series, list[Cost]]]) -> None:
    """Draw a panel a series: times on the left scale, memory on the right."""
    with styled():
        figure = new_figure(16.0, 7.5)
        axes = figure.subplots(2, 4)
        for panel, (series, costs) in zip(axes.flat, measured, strict=False):
            memory = panel.twinx()
            for name, line in lines_of(costs).items():
                on, colour = (memory, "0.6") if name == "memory" else (panel, None)
                label = name
                if series.logarithmic:
                    label = f"{name}, exponent {exponent(series.values, line):.2f}"
                on.plot(series.values, line, "o-", label=label, color=colour)
            panel.set(title=series.title, xlabel=series.label, ylabel="time in ms", yscale="log")
            memory.set(ylabel="memory in MiB", yscale="log")
            if series.logarithmic:
                panel.set(xscale="log", xticks=series.values, xticklabels=map(short, series.values))
            for axis in (panel, memory):
                widen(axis)
                axis.minorticks_off()
            handles = [*panel.get_lines(), *memory.get_lines()]
            panel.legend(handles=handles, fontsize="x-small")
        for panel in axes.flat[len(measured) :]:
            panel.remove()
        save(figure, FIGURE)


def widen(axis: Axes) -> None:
    """Show a factor of 30 at least, so that noise does not look like growth."""
    lowest, highest = axis.get_ylim()
    middle, half = np.sqrt(lowest * highest), max(np.sqrt(highest / lowest), np.sqrt(30.0))
    axis.set_ylim(middle / half, middle * half)


def short(value: float) -> str:
    """Tick label of few characters."""
    return (
        f"{value / 1e6:.2g} M" if value >= 1e6 else f"{value / 1e3:.3g} k" if value >= 1e4 else f"{value:g}"
    )


def table(measured: list[tuple[Series, list[Cost]]]) -> str:
    """Exponents of every series, and the ends of its lines."""
    rows = [
        "| varied | from | to | echo | noise | image | memory | image in ms | memory in MiB |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for series, costs in measured:
        lines = lines_of(costs)
        slopes = [
            f"{exponent(series.values, line):.2f}" if series.logarithmic else "" for line in lines.values()
        ]
        ends = [f"{line[0]:.0f} to {line[-1]:.0f}" for line in (lines["image"], lines["memory"])]
        rows.append(
            f"| {series.title} | {series.values[0]:.6g} | {series.values[-1]:.8g} "
            f"| {' | '.join(slopes)} | {' | '.join(ends)} |"
        )
    return "\n".join(rows)


def write(text: str) -> None:
    """Put the table between its marks."""
    page = PAGE.read_text()
    before, rest = page.split(START)
    after = rest.split(END, 1)[1]
    PAGE.write_text(f"{before}{START}\n{text}\n{END}{after}")


if __name__ == "__main__":
    main()
