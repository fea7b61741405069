"""Cost of an image of a recorded frame: computed for an estimator, and for the full chain.

The full 4-D chain transforms every element over all subcarriers and symbols,
then every range-Doppler cell over the array. The part that a scene needs follows
from the region (gate), from what the estimator declares to read (elements,
cells) and from the sizes (which transform).

Operations are real additions and multiplications: 5 N log2 N for an FFT, 8 for
a complex product and its addition, 4 where one factor is real. Those of a
matrix product take a sixteenth of the time of those of a strided FFT
(`isacbench.dsp.partial_dft`). The subcarriers are taken to be outermost.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.dsp.partial_dft import doppler_sums, range_method
from isacbench.model.gate import build_gate
from isacbench.plugins.contracts import needs_of

if TYPE_CHECKING:
    from numpy.typing import DTypeLike

    from isacbench.model.scene import Scenario
    from isacbench.plugins.contracts import Estimator

ANGLE_OVERSAMPLING = 3
"""Points of an angle FFT an element, as many as `fft4d` takes on the paper's array."""

DOUBLE_BYTES = 16
"""Of a complex number of a cell of the gate."""

HEADER = ["step", "computed", "cells", "of full", "bytes", "of full", "operations", "of full"]


@dataclass(frozen=True)
class Work:
    """Numbers that come out, bytes read and written in main memory or on disk, and real operations."""

    cells: int
    bytes: int
    operations: int

    def __add__(self, other: Work) -> Work:
        return Work(self.cells + other.cells, self.bytes + other.bytes, self.operations + other.operations)


@dataclass(frozen=True)
class Step:
    """A step of the chain: how it is done, what is computed, and what the full chain would compute."""

    name: str
    method: str
    computed: Work
    full: Work


@dataclass(frozen=True)
class Cost:
    """Cost of an estimator's image of a frame.

    Attributes
    ----------
    description : dict
        Elements, needs, bins and precision, in terms of JSON.
    steps : tuple of Step
        In their order.
    simulation : tuple of Step
        Steps in place of reading and transforming, if the gate is simulated in
        closed form instead of recorded.
    """

    description: dict[str, Any]
    steps: tuple[Step, ...]
    simulation: tuple[Step, ...]

    @property
    def total(self) -> Step:
        """Work of all steps, and that of the full chain."""
        none = Work(0, 0, 0)
        computed, full = ([getattr(step, part) for step in self.steps] for part in ("computed", "full"))
        return Step("total", "", sum(computed, none), sum(full, none))

    def rows(self) -> list[list[str]]:
        """Table under `HEADER`: the steps and their total, and what a simulated frame takes instead."""
        simulated = [[f"{step.name} (simulated)", *_cells(step)[1:]] for step in self.simulation]
        return [*(_cells(step) for step in (*self.steps, self.total)), *simulated]

    def to_json(self) -> dict[str, Any]:
        """Everything in terms of JSON."""
        steps, simulation = ([asdict(step) for step in part] for part in (self.steps, self.simulation))
        total = {part: asdict(getattr(self.total, part)) for part in ("computed", "full")}
        return {**self.description, "steps": steps, "simulation": simulation, "total": total}


def image_cost(scenario: Scenario, estimator: Estimator, dtype: DTypeLike = np.complex64) -> Cost:
    """Count the work of an image of a recorded frame, whose numbers are of a type.

    Examples
    --------
    >>> from isacbench import get_estimator, load_scenario
    >>> cost = image_cost(load_scenario("street"), get_estimator("music2d", integration="element"))
    >>> [step.method for step in cost.steps[:2]]
    ['31 of 256 elements', 'partial DFT, 33 of 224 bins']
    """
    needs = needs_of(estimator)
    scenario.require_default("a recorded frame", "mimo")
    gate = build_gate(scenario.system, scenario.base_station_m, scenario.region)
    n, m, lengths = scenario.system.n_subcarriers, scenario.system.n_symbols, scenario.array.shape
    (r, d), size, n_all = gate.shape, np.dtype(dtype).itemsize, math.prod(lengths)
    e = {"plane": n_all, "cross": sum(lengths) - 1, "none": 0}[needs.elements]
    frame, gated = n * m * n_all, r * d * e

    # Symbols are summed in blocks in the cache: only lines for an FFT are written.
    rows, is_partial = doppler_sums(gate.doppler_bins, m).rows, range_method(r, n) == "partial"
    sums = n * len(rows) * e
    doppler = Work(
        n * d * e, 0 if is_partial else 2 * sums * size, (8 if np.iscomplexobj(rows) else 4) * m * sums
    )
    along_range = sums * (8 * r if is_partial else _fft_operations(n))

    averaged = e if needs.integration == "noncoherent" else 1
    mapped = r * d if needs.integration is not None else 0
    power = f"power of {averaged} element{'s' * (averaged > 1)}" if mapped else "no map"

    # Directions in units of an angle FFT of a cell: an estimator's own operations are not known.
    reachable = int(np.count_nonzero(gate.reachable))
    n_cells, cells = {
        "gate": (r * d, "all cells of the gate"),
        "detected": (reachable, f"detected cells, at most the {reachable} reachable ones"),
        "none": (0, "no cell"),
    }[needs.cells]
    lines = [ANGLE_OVERSAMPLING * length for length in lengths]
    plane = math.prod(lines)
    n_points, operations = plane, plane * _fft_operations(plane)
    if needs.elements != "plane":
        n_points, operations = sum(lines), sum(line * _fft_operations(line) for line in lines)

    steps = (
        Step(
            "read",
            f"{e} of {n_all} elements",
            Work(n * m * e, n * m * e * size, 0),
            Work(frame, frame * size, 0),
        ),
        Step(
            "Doppler",
            f"partial DFT, {d} of {m} bins",
            doppler,
            Work(frame, 2 * frame * size, frame * _fft_operations(m)),
        ),
        Step(
            "range",
            f"{'partial DFT' if is_partial else 'FFT'}, {r} of {n} bins",
            Work(gated, 2 * gated * DOUBLE_BYTES, along_range),
            Work(frame, 2 * frame * size, frame * _fft_operations(n)),
        ),
        Step(
            "detection",
            power,
            Work(mapped, 16 * mapped * averaged, 4 * mapped * averaged),
            Work(n * m, size * frame, 4 * frame),
        ),
        Step(
            "angles",
            cells,
            Work(n_cells * n_points, 16 * n_cells * e, n_cells * operations),
            Work(n * m * plane, size * n * m * (n_all + plane), n * m * plane * _fft_operations(plane)),
        ),
    )

    # Echoes are summed once a scene, those of one speed first. Noise is two normal numbers a cell.
    n_echoes, n_speeds = len(scenario.scatterers), np.unique(scenario.scatterers.velocity).size
    whole = r * d * n_all
    echo = Work(whole, whole * DOUBLE_BYTES, 8 * (r * n_all * n_echoes + whole * n_speeds))
    full_echo = Work(frame, frame * size, 8 * (n * n_all * n_echoes + frame * n_speeds))
    noise, full_noise = Work(whole, whole * DOUBLE_BYTES, 2 * whole), Work(frame, frame * size, 2 * frame)
    description = {
        "elements": {"read": e, "all": n_all},
        "needs": asdict(needs),
        "range_bins": [int(gate.range_bins[0]), int(gate.range_bins[-1])],
        "doppler_bins": [int(gate.doppler_bins[0]), int(gate.doppler_bins[-1])],
        "range_method": "partial" if is_partial else "fft",
        "dtype": str(np.dtype(dtype)),
    }
    name = "cells of the gate"
    return Cost(
        description, steps, (Step("echo", name, echo, full_echo), Step("noise", name, noise, full_noise))
    )


def _fft_operations(n: int) -> int:
    """Operations a point of an FFT of a length."""
    return round(5 * math.log2(max(n, 2)))


def _cells(step: Step) -> list[str]:
    """Name, method, and amounts of work in three digits and a prefix, such as 1.23 k, each with its share."""
    from matplotlib.ticker import EngFormatter

    cells = [step.name, step.method]
    for name, unit in (("cells", ""), ("bytes", "B"), ("operations", "")):
        part, whole = getattr(step.computed, name), getattr(step.full, name)
        percent = 100 * part / whole if whole else math.nan
        share = f"{percent:.0f} %" if percent >= 10 else f"{percent:.2g} %"
        cells += [EngFormatter(unit)(float(f"{part:.3g}")).strip(), share if whole else ""]
    return cells
