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

import math
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from isacbench.dsp.beam_integration import Beams
from isacbench.dsp.partial_dft import doppler_sums, range_method
from isacbench.model.gate import build_gate
from isacbench.model.observation import cosine_limits
from isacbench.model.scene import Scenario
from isacbench.plugins.contracts import Estimator, needs_of

ANGLE_OVERSAMPLING = 3
"""Points of an angle FFT an element, as many as `fft4d` takes on the paper's array."""

DOUBLE_BYTES = 16
"""Of a complex number of a cell of the gate."""

HEADER = ["step", "computed", "cells", "of full", "bytes", "of full", "operations", "of full"]


AMOUNTS = {"cells": "", "bytes": "B", "operations": ""}
"""Units of work: numbers that come out, bytes read and written in main memory or on disk, operations."""

Content = dict[str, Any]
Work = tuple[int, ...]


def image_cost(scenario: Scenario, estimator: Estimator, dtype: DTypeLike = np.complex64) -> Content:
    """Count the work of an image of a recorded frame, whose numbers are of a type, in terms of JSON.

    ``steps`` and their ``total`` have what is computed and what the full chain would; ``simulation`` has the
    steps in place of reading and transforming, if the gate is simulated in closed form instead of recorded.

    Examples
    --------
    >>> from isacbench import get_estimator, load_scenario
    >>> cost = image_cost(load_scenario("street"), get_estimator("music2d", integration="element"))
    >>> [step["method"] for step in cost["steps"][:2]]
    ['31 of 256 elements', 'partial DFT, 33 of 224 bins']
    """
    needs = needs_of(estimator)
    scenario.require_default("a recorded frame", "mimo")
    gate = build_gate(scenario.system, scenario.base_station_m, scenario.region)
    n, m, lengths = scenario.system.n_subcarriers, scenario.system.n_symbols, scenario.array.shape
    (r, d), size, n_all = gate.shape, np.dtype(dtype).itemsize, math.prod(lengths)
    e = {"plane": n_all, "cross": sum(lengths) - 1, "none": 0}[needs.elements]
    frame, read, gated = n * m * n_all, n * m * e, r * d * e
    moved = 2 * frame * size  # read and written once

    along_symbols, along_subcarriers = _fft_operations(m), _fft_operations(n)
    # Symbols are summed in blocks in the cache: only lines for an FFT are written.
    rows, is_partial = doppler_sums(gate.doppler_bins, m).rows, range_method(r, n) == "partial"
    sums = n * len(rows) * e
    row_operations = 8 if np.iscomplexobj(rows) else 4
    doppler = n * d * e, 0 if is_partial else 2 * sums * size, row_operations * m * sums
    along_range = gated, 2 * gated * DOUBLE_BYTES, sums * (8 * r if is_partial else along_subcarriers)

    averaged = 1 if needs.integration == "element" else e
    mapped = r * d if needs.integration is not None else 0
    power = f"power of {averaged} element{'s' * (averaged > 1)}" if mapped else "no map"
    forming = 0  # beams of a cell: along w for each element of a column, then along u
    if needs.integration == "beams":
        limits = cosine_limits(scenario.region, scenario.base_station_m, scenario.frame)
        n_u, n_w = (along.size for along in Beams(lengths, limits).cosines)
        forming = 8 * (n_all * n_w + lengths[0] * n_u * n_w)
        power = f"{n_u * n_w} beams of {e} elements"

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

    detection = mapped, 16 * mapped * averaged, mapped * (4 * averaged + forming)
    angles = n_cells * n_points, 16 * n_cells * e, n_cells * operations
    all_angles = n * m * plane, size * n * m * (n_all + plane), n * m * plane * _fft_operations(plane)
    method = f"{'partial DFT' if is_partial else 'FFT'}, {r} of {n} bins"
    steps = [
        _step("read", f"{e} of {n_all} elements", (read, read * size, 0), (frame, frame * size, 0)),
        _step("Doppler", f"partial DFT, {d} of {m} bins", doppler, (frame, moved, frame * along_symbols)),
        _step("range", method, along_range, (frame, moved, frame * along_subcarriers)),
        _step("detection", power, detection, (n * m, size * frame, 4 * frame)),
        _step("angles", cells, angles, all_angles),
    ]

    # Echoes are summed once a scene, those of one speed first. Noise is two normal numbers a cell.
    n_echoes, n_speeds = len(scenario.scatterers), np.unique(scenario.scatterers.velocity).size
    whole = r * d * n_all
    echo = whole, whole * DOUBLE_BYTES, 8 * (r * n_all * n_echoes + whole * n_speeds)
    full_echo = frame, frame * size, 8 * (n * n_all * n_echoes + frame * n_speeds)
    noise, full_noise = (whole, whole * DOUBLE_BYTES, 2 * whole), (frame, frame * size, 2 * frame)
    gated_cells = "cells of the gate"
    return {
        "elements": {"read": e, "all": n_all},
        "needs": asdict(needs),
        "range_bins": [int(gate.range_bins[0]), int(gate.range_bins[-1])],
        "doppler_bins": [int(gate.doppler_bins[0]), int(gate.doppler_bins[-1])],
        "range_method": "partial" if is_partial else "fft",
        "dtype": str(np.dtype(dtype)),
        "steps": steps,
        "simulation": [
            _step("echo", gated_cells, echo, full_echo),
            _step("noise", gated_cells, noise, full_noise),
        ],
        "total": {
            part: {amount: sum(step[part][amount] for step in steps) for amount in AMOUNTS}
            for part in ("computed", "full")
        },
    }


def _step(name: str, method: str, computed: Work, full: Work) -> Content:
    amounts = {"computed": computed, "full": full}
    return {
        "name": name,
        "method": method,
        **{part: dict(zip(AMOUNTS, work, strict=True)) for part, work in amounts.items()},
    }


def _fft_operations(n: int) -> int:
    """Operations a point of an FFT of a length."""
    return round(5 * math.log2(max(n, 2)))


def cost_rows(cost: Content) -> list[list[str]]:
    """Table under `HEADER`: the steps and their total, and what a simulated frame takes instead.

    Amounts of work have three digits and a prefix, such as 1.23 k, and each its share.
    """
    from matplotlib.ticker import EngFormatter

    rows = []
    simulated = [{**step, "name": f"{step['name']} (simulated)"} for step in cost["simulation"]]
    for step in (*cost["steps"], {"name": "total", "method": "", **cost["total"]}, *simulated):
        rows.append([step["name"], step["method"]])
        for amount, unit in AMOUNTS.items():
            part, whole = step["computed"][amount], step["full"][amount]
            percent = 100 * part / whole if whole else math.nan
            share = f"{percent:.0f} %" if percent >= 10 else f"{percent:.2g} %"
            rows[-1] += [EngFormatter(unit)(float(f"{part:.3g}")).strip(), share if whole else ""]
    return rows
