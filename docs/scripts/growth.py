"""Growth of runs, their reports and observations: the table and the picture of ``docs/performance.md``.

Each size is a process of its own, whose processor time and largest memory count, imports included.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from isacbench.charts import COLOURS, Axis, Chart, ChartGroup, LineStyle, Series
from isacbench.report.figures import draw_charts, save, styled

FIGURE = Path(__file__).parents[1] / "images" / "growth.png"

PREPARED = """
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar
import numpy as np
import isacbench
from isacbench.bench.store.run import Run
from isacbench.report.run_report import write_report

n = int(sys.argv[1])
street = isacbench.load_scenario("street")
random = np.random.default_rng(0)

@dataclass(frozen=True)
class Big:
    name: ClassVar[str] = "big"

    def estimate(self, observation):
        xyz = random.uniform(street.region.lower_m, street.region.upper_m, (n, 3))
        return isacbench.PointCloud(xyz, random.uniform(-10, 10, n), random.random(n))

Path("points.csv").write_text("x,y,z,v,amplitude\\n1,2,3,0,1\\n5,6,1,10,2\\n9,9,2,-10,1\\n")
Path("tiny.toml").write_text('''
name = "tiny"
system = {n_subcarriers = 256, n_symbols = 32}
array = {frame = "panel", tx_shape = [1, 1], rx_shape = [4, 4]}
base_station = {position_m = [5, 40, 10]}
region = {x_m = [0, 10], y_m = [0, 10], z_m = [0, 5], speed_mps = [-15, 15]}
objects = [{kind = "points", file = "points.csv"}]
''')

def run(scene, *estimators, trials=1):
    choice = {"scenarios": [scene], "estimators": estimators, "snr_db": [10], "trials": trials}
    isacbench.run("quick", out="out", **choice)
    return Run.open(Path("out"))
"""

CASES = {
    "rows": ("run('tiny.toml', 'empty', 'chance', trials=n // 2)", (1000, 3000, 10_000)),
    "rows with their report": (
        "write_report(run('tiny.toml', 'empty', 'chance', trials=n // 2))",
        (1000, 3000, 10_000),
    ),
    "scenes with their report": ("write_report(run(f'crowd[seed=0:{n - 1}]', 'empty'))", (100, 300, 1000)),
    "points of an image with their report": ("write_report(run('street', Big()))", (1000, 10_000, 100_000)),
    "scatterers observed": (
        "one = street.scatterers; k = np.arange(n) % len(one)\n"
        "parts = {name: getattr(one, name)[k] for name in ('xyz', 'velocity', 'amplitude', 'phase_rad')}\n"
        "isacbench.observe(replace(street, scatterers=replace(one, objects=(), **parts)), 10)",
        (500, 1500, 5000),
    ),
}


def measure(code: str, n: int) -> tuple[float, float]:
    """Processor time in s and largest memory in MB of some code for a size."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-W", "ignore", "-c", PREPARED + code, str(n)]
        process = subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL)
        _, status, used = os.wait4(process.pid, 0)
    assert status == 0, code
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


if __name__ == "__main__":
    times, memories = [], []
    print("| what grows | sizes | processor time [s] | memory [MB] |\n|---|---|---|---|")
    for (name, (code, sizes)), colour in zip(CASES.items(), COLOURS, strict=False):
        found = [measure(code, n) for n in sizes]
        columns = [
            [f"{n}" for n in sizes],
            *([f"{one:.3g}" for one in values] for values in zip(*found, strict=True)),
        ]
        print(f"| {name} | {' | '.join(', '.join(texts) for texts in columns)} |", flush=True)
        time_s, memory_mb = zip(*found, strict=True)
        times.append(Series(name, sizes, time_s, style=LineStyle(colour)))
        memories.append(Series(name, sizes, memory_mb, style=LineStyle(colour)))
    x = Axis("size", log=True)
    charts = [
        Chart("processor time", x, Axis("[s]", log=True), times),
        Chart("largest memory", x, Axis("[MB]", log=True), memories),
    ]
    with styled():
        save(draw_charts(ChartGroup("growth", "Growth of runs, reports and observations", charts)), FIGURE)
