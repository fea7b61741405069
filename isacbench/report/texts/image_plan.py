"""Plan of an image, for the terminal and as JSON."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from matplotlib.ticker import EngFormatter

from isacbench.charts import Table, text_table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from isacbench.cubes.image_cost import ImagePlan, Step, Work
    from isacbench.model.numerology import System

ELEMENTS = {"plane": "the whole array", "cross": "one column and one row", "none": "none"}
HEADER = ["step", "computed", "cells", "of full", "bytes", "of full", "operations", "of full"]
TRANSFORMS = {"partial": "products with rows of the DFT matrix", "fft": "FFT"}


def plan_lines(plan: ImagePlan, system: System) -> list[str]:
    """List the parts of the frame and of the map that an estimator needs.

    Parameters
    ----------
    plan : ImagePlan
    system : System

    Returns
    -------
    list of str
        Lines of text.
    """
    gate, needs = plan.gate, plan.needs
    near, far = (int(bin_) for bin_ in gate.range_bins[[0, -1]])
    slow, fast = (int(bin_) for bin_ in gate.doppler_bins[[0, -1]])
    n_range, n_doppler = gate.shape
    integration = {"noncoherent": "the power of all of them", "element": "one of them", None: "no power map"}
    return [
        f"  elements:      {plan.n_elements} of {plan.n_all_elements}, {ELEMENTS[needs.elements]}",
        f"  range bins:    {n_range} of {system.n_subcarriers}, {near * system.range_bin_m:.1f} to "
        f"{far * system.range_bin_m:.1f} m, by {TRANSFORMS[plan.range_method]}",
        f"  Doppler bins:  {n_doppler} of {system.n_symbols}, {slow * system.velocity_bin_mps:.1f} to "
        f"{fast * system.velocity_bin_mps:.1f} m/s, by {TRANSFORMS['partial']}",
        f"  detection on:  {integration[needs.integration]}",
        f"  precision:     sums over symbols in {plan.dtype}, over subcarriers in complex128",
    ]


def plan_grids(plan: ImagePlan) -> list[Table]:
    """Tabulate the steps for a recorded and a simulated frame: amounts of work, and shares of the full chain.

    Parameters
    ----------
    plan : ImagePlan

    Returns
    -------
    list of Table
    """
    recorded = [*_rows(plan.steps), ["total", "", *_amounts(*plan.total)]]
    return [
        text_table("recorded frame, compared with the full 4-D chain", HEADER, recorded),
        text_table(
            "simulated frame: work instead of reading and transforming", HEADER, _rows(plan.simulation)
        ),
    ]


def _rows(steps: Sequence[Step]) -> list[list[str]]:
    return [[step.name, step.method, *_amounts(step.computed, step.full)] for step in steps]


def describe_plan(plan: ImagePlan) -> dict[str, Any]:
    """Describe a plan for JSON.

    Parameters
    ----------
    plan : ImagePlan

    Returns
    -------
    dict
    """
    computed, full = plan.total
    return {
        "elements": {"read": plan.n_elements, "all": plan.n_all_elements},
        "needs": asdict(plan.needs),
        "range_bins": [int(plan.gate.range_bins[0]), int(plan.gate.range_bins[-1])],
        "doppler_bins": [int(plan.gate.doppler_bins[0]), int(plan.gate.doppler_bins[-1])],
        "range_method": plan.range_method,
        "dtype": str(plan.dtype),
        "steps": [asdict(step) for step in plan.steps],
        "simulation": [asdict(step) for step in plan.simulation],
        "total": {"computed": asdict(computed), "full": asdict(full)},
    }


def _amounts(computed: Work, full: Work) -> list[str]:
    """Write cells, bytes and operations, each with its share."""
    amounts = []
    for name, unit in (("cells", ""), ("bytes", "B"), ("operations", "")):
        part, whole = getattr(computed, name), getattr(full, name)
        # Three digits and a prefix, such as 1.23 k.
        amounts += [EngFormatter(unit)(float(f"{part:.3g}")).strip(), _share(part, whole)]
    return amounts


def _share(part: int, whole: int) -> str:
    """Write a part in percent of the whole, with two digits below 10 %."""
    if not whole:
        return ""
    percent = 100 * part / whole
    return f"{percent:.0f} %" if percent >= 10 else f"{percent:.2g} %"
