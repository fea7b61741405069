"""Count the false alarms of every detector in noise, and write them into docs/detectors.md.

Every window is drawn anew, and one cell of it is tested: decisions of a cell
of the table are independent, and their number is binomial. The decisions are
those of the detectors themselves. A window that raises no alarm at the highest
rate raises none at a lower one, so that only those that do are tested further.

    python docs/scripts/false_alarm_rates.py --windows 4000000 --jobs 2
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import product
from pathlib import Path
from time import perf_counter

import numpy as np
from scipy.stats import binomtest
from threadpoolctl import threadpool_limits

from isacbench import get_detector
from isacbench.report.figures import new_figure, save, styled

DOCS = Path(__file__).resolve().parents[1]
PAGE, FIGURE = DOCS / "detectors.md", DOCS / "images" / "false-alarm-rates.png"
START, END = "<!-- false-alarm rates: written by docs/scripts/false_alarm_rates.py -->", "<!-- end -->"

SIZE = 9
NAMES = ("ca", "os", "osca", "osca, guard 1", "goca", "soca", "tm")
PLACES = {"interior": (4, 4), "border": (0, 4), "corner": (0, 0)}
LOOKS = (1, 16, 256)
RATES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
N_CHUNK = 20_000
FAMILY_ERROR = 0.01


def detectors(pfa: float) -> dict[str, object]:
    """Every detector with its default window of 9 x 9 cells in maps that do not mix along axis 2."""
    built = {}
    for name in NAMES:
        sizes = {"training": (4, 4, 0)} if name == "osca" else {"training": (3, 3, 0), "guard": (1, 1, 0)}
        built[name] = get_detector(name.split(",")[0], pfa=pfa, **sizes)
    return built


def count_chunk(looks: int, chunk: int) -> np.ndarray:
    """Alarms of one chunk of windows, shape (detectors, places, rates)."""
    rng = np.random.default_rng([looks, chunk])
    power = rng.standard_gamma(looks, (SIZE, SIZE, N_CHUNK)) / looks
    alarms = np.zeros((len(NAMES), len(PLACES), len(RATES)), dtype=int)
    for (i, detector), (j, place) in product(
        enumerate(detectors(RATES[0]).values()), enumerate(PLACES.values())
    ):
        windows = power
        for k, pfa in enumerate(RATES):
            n_left = windows.shape[2]
            cells = *(np.full(n_left, index) for index in place), np.arange(n_left)
            if n_left:
                windows = windows[:, :, replace(detector, pfa=pfa).detect(windows, looks, cells).mask]
            alarms[i, j, k] = windows.shape[2]
    return alarms


def count_chunks(looks: int, chunks: range) -> np.ndarray:
    """Alarms of several chunks on one thread."""
    with threadpool_limits(limits=1):
        return sum(count_chunk(looks, chunk) for chunk in chunks)


def count(n_windows: int, jobs: int) -> dict[int, np.ndarray]:
    """Alarms for each number of looks."""
    n_chunks = n_windows // N_CHUNK
    batches = [range(start, min(start + 10, n_chunks)) for start in range(0, n_chunks, 10)]
    with ProcessPoolExecutor(jobs) as pool:
        tasks = {looks: [pool.submit(count_chunks, looks, batch) for batch in batches] for looks in LOOKS}
        return {looks: sum(task.result() for task in some) for looks, some in tasks.items()}


def holm(p_values: np.ndarray) -> np.ndarray:
    """Holm's adjusted p-values of a family of tests."""
    order = np.argsort(p_values)
    adjusted = np.empty(p_values.size)
    adjusted[order] = np.maximum.accumulate(p_values[order] * np.arange(p_values.size, 0, -1))
    return np.minimum(adjusted, 1.0)


def report(alarms: dict[int, np.ndarray], n_windows: int) -> Iterator[str]:
    """Tables and verdict in Markdown."""
    counts = np.array([alarms[looks] for looks in LOOKS])
    nominal = np.broadcast_to(RATES, counts.shape)
    p_values = np.array(
        [binomtest(int(k), n_windows, p).pvalue for k, p in zip(counts.ravel(), nominal.ravel(), strict=True)]
    )
    outside = (holm(p_values) < FAMILY_ERROR).reshape(counts.shape)
    yield f"{n_windows} windows a cell of the tables; bold lies outside the band.\n"
    for looks, table, bold in zip(LOOKS, counts, outside, strict=True):
        yield f"\n{looks} {'look' if looks == 1 else 'looks'}:\n"
        yield "\n| detector | cell | " + " | ".join(f"{rate:.0e}" for rate in RATES) + " |\n"
        yield "|---" * (2 + len(RATES)) + "|\n"
        for (i, name), (j, place) in product(enumerate(NAMES), enumerate(PLACES)):
            rates = (
                f"**{count / n_windows:.3e}**" if out else f"{count / n_windows:.3e}"
                for count, out in zip(table[i, j], bold[i, j], strict=True)
            )
            yield f"| {name} | {place} | " + " | ".join(rates) + " |\n"
    deviation = np.abs(counts / (nominal * n_windows) - 1).max(axis=(0, 1, 2))
    most = ", ".join(f"{off:.1%} at {rate:.0e}" for off, rate in zip(deviation, RATES, strict=True))
    yield (
        f"\nOf {p_values.size} exact binomial tests, {np.count_nonzero(outside)} lie outside the family-wise "
        f"{1 - FAMILY_ERROR:.0%} band (Holm); the smallest p-value is {p_values.min():.2g}, where the "
        f"band asks for {FAMILY_ERROR / p_values.size:.2g}. Largest deviations from nominal: {most}.\n"
    )


def draw(alarms: dict[int, np.ndarray], n_windows: int) -> None:
    """Measured over nominal rate, with the 99 % band of a single count."""
    with styled():
        figure = new_figure(9.0, 3.6)
        axes = figure.subplots(1, len(LOOKS), sharey=True)
        for axis, looks in zip(axes, LOOKS, strict=True):
            rates = np.array(RATES)
            spread = 2.576 * np.sqrt((1 - rates) / (rates * n_windows))
            axis.fill_between(rates, 1 - spread, 1 + spread, color="0.9", label="99 % of a single count")
            for (i, name), j in product(enumerate(NAMES), range(len(PLACES))):
                ratio = alarms[looks][i, j] / (rates * n_windows)
                shift = 1.12 ** (i - 3) * 1.03 ** (j - 1)
                axis.plot(rates * shift, ratio, "os^"[j], color=f"C{i}", ms=3, label=name if j == 0 else None)
            axis.set_xscale("log")
            axis.set_xlabel("nominal false-alarm rate")
            axis.set_title(f"{looks} look{'s' if looks > 1 else ''}")
        axes[0].set_ylabel("measured / nominal")
        axes[0].set_ylim(0, 2.2)
        handles = axes[0].get_legend_handles_labels()[0]
        figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False)
        save(figure, FIGURE)


def main() -> None:
    """Count, and write the page and the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument(
        "--windows", type=int, default=4_000_000, help="windows drawn for each number of looks"
    )
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    given = parser.parse_args()
    n_windows = given.windows // N_CHUNK * N_CHUNK
    start = perf_counter()
    alarms = count(n_windows, given.jobs)
    text = "".join(report(alarms, n_windows))
    page = PAGE.read_text(encoding="utf-8")
    before, _, rest = page.partition(START)
    after = rest.partition(END)[2]
    PAGE.write_text(f"{before}{START}\n\n{text}\n{END}{after}", encoding="utf-8")
    draw(alarms, n_windows)
    print(text)
    print(f"{perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main()
