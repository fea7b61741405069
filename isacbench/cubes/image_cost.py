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
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.dsp.partial_dft import RangeMethod, doppler_sums, range_method
from isacbench.model.gate import Gate, build_gate
from isacbench.plugins.contracts import needs_of

if TYPE_CHECKING:
    from numpy.typing import DTypeLike

    from isacbench.model.scene import Scenario
    from isacbench.plugins.contracts import Estimator, Needs

ANGLE_OVERSAMPLING = 3
"""Points of an angle FFT an element, as many as `fft4d` takes on the paper's array."""


@dataclass(frozen=True)
class Work:
    """An amount of work.

    Attributes
    ----------
    cells : int
        Numbers that come out.
    bytes : int
        Read and written in main memory or on disk.
    operations : int
        Real additions and multiplications.
    """

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
class ImagePlan:
    """Cost of an estimator's image of a frame.

    Attributes
    ----------
    gate : Gate
    needs : Needs
        Input that the estimator declares to read.
    range_method : {"partial", "fft"}
    n_elements, n_all_elements : int
        Elements that are read, and those of the array.
    dtype : dtype
        Of the cube, in which blocks are transformed.
    steps : tuple of Step
        In their order.
    simulation : tuple of Step
        Steps in place of reading and transforming, if the gate is simulated in
        closed form instead of recorded.
    """

    gate: Gate
    needs: Needs
    range_method: RangeMethod
    n_elements: int
    n_all_elements: int
    dtype: np.dtype[Any]
    steps: tuple[Step, ...]
    simulation: tuple[Step, ...]

    @property
    def total(self) -> tuple[Work, Work]:
        """Work of all steps, and that of the full chain."""
        none = Work(0, 0, 0)
        return (
            sum((step.computed for step in self.steps), none),
            sum((step.full for step in self.steps), none),
        )


def plan_image(scenario: Scenario, estimator: Estimator, dtype: DTypeLike = np.complex64) -> ImagePlan:
    """Plan the image of a recorded frame.

    Parameters
    ----------
    scenario : Scenario
    estimator : Estimator
    dtype : dtype_like
        Of the cube.

    Returns
    -------
    ImagePlan

    Examples
    --------
    >>> from isacbench import get_estimator, load_scenario
    >>> plan = plan_image(load_scenario("street"), get_estimator("music2d", integration="element"))
    >>> plan.n_elements, plan.gate.shape
    (31, (89, 33))
    """
    needs = needs_of(estimator)
    scenario.require_default("a recorded frame", "mimo")
    gate = build_gate(scenario.system, scenario.base_station_m, scenario.region)
    n_p, n_q = scenario.array.shape
    n_elements = {"plane": n_p * n_q, "cross": n_p + n_q - 1, "none": 0}[needs.elements]
    sizes = _Sizes(scenario, gate, needs, n_elements, np.dtype(dtype).itemsize)
    steps = (sizes.read(), sizes.doppler(), sizes.range(), sizes.detection(), sizes.angles())
    return ImagePlan(
        gate=gate,
        needs=needs,
        range_method=sizes.range_method,
        n_elements=n_elements,
        n_all_elements=n_p * n_q,
        dtype=np.dtype(dtype),
        steps=steps,
        simulation=(sizes.echo(scenario), sizes.noise()),
    )


class _Sizes:
    """Sizes of the full chain and of the part that is needed, and the work that follows for every step."""

    def __init__(self, scenario: Scenario, gate: Gate, needs: Needs, n_elements: int, itemsize: int) -> None:
        system = scenario.system
        self.n, self.m, self.shape = system.n_subcarriers, system.n_symbols, scenario.array.shape
        self.r, self.d = gate.shape
        self.e, self.all = n_elements, self.shape[0] * self.shape[1]
        self.gate, self.needs, self.itemsize = gate, needs, itemsize
        self.range_method = range_method(self.r, self.n)
        rows = doppler_sums(gate.doppler_bins, self.m).rows
        self.k, self.operations_a_row = len(rows), 8 if np.iscomplexobj(rows) else 4

    def read(self) -> Step:
        """Numbers of the frame that are touched, once."""

        def work(n_elements: int) -> Work:
            n_cells = self.n * self.m * n_elements
            return Work(n_cells, n_cells * self.itemsize, 0)

        return Step("read", f"{self.e} of {self.all} elements", work(self.e), work(self.all))

    def doppler(self) -> Step:
        """Transform over symbols of blocks in the cache: what has been read is not written again."""
        n_sums = self.n * self.k * self.e
        lines = n_sums if self.range_method == "fft" else 0
        n_all = self.n * self.m * self.all
        return Step(
            "Doppler",
            f"partial DFT, {self.d} of {self.m} bins",
            Work(
                self.n * self.d * self.e,
                2 * lines * self.itemsize,
                self.operations_a_row * self.m * n_sums,
            ),
            Work(n_all, 2 * n_all * self.itemsize, n_all * _fft_operations(self.m)),
        )

    def range(self) -> Step:
        """Transform over subcarriers."""
        n_cells, n_all = self.r * self.d * self.e, self.n * self.m * self.all
        if self.range_method == "partial":
            method, operations = "partial DFT", 8 * self.n * self.r * self.k * self.e
        else:
            method, operations = "FFT", self.n * self.k * self.e * _fft_operations(self.n)
        return Step(
            "range",
            f"{method}, {self.r} of {self.n} bins",
            Work(n_cells, 2 * n_cells * np.dtype(np.complex128).itemsize, operations),
            Work(n_all, 2 * n_all * self.itemsize, n_all * _fft_operations(self.n)),
        )

    def detection(self) -> Step:
        """Power of every cell, averaged over elements, and its test."""
        averaged = self.e if self.needs.integration == "noncoherent" else 1
        n_cells = self.r * self.d if self.needs.integration is not None else 0
        n_all = self.n * self.m
        return Step(
            "detection",
            "no map"
            if self.needs.integration is None
            else f"power of {averaged} element{'s' * (averaged > 1)}",
            Work(n_cells, 16 * n_cells * averaged, 4 * n_cells * averaged),
            Work(n_all, self.itemsize * n_all * self.all, 4 * n_all * self.all),
        )

    def angles(self) -> Step:
        """Directions, in units of an angle FFT of a cell: an estimator's own operations are not known."""
        reachable = int(np.count_nonzero(self.gate.reachable))
        n_cells = {"gate": self.r * self.d, "detected": reachable, "none": 0}[self.needs.cells]
        lines = [ANGLE_OVERSAMPLING * n for n in self.shape]
        plane = lines[0] * lines[1]
        each = sum(n * _fft_operations(n) for n in lines)
        full = plane * _fft_operations(plane)
        n_points, operations = (plane, full) if self.needs.elements == "plane" else (sum(lines), each)
        n_all = self.n * self.m
        method = {
            "gate": "all cells of the gate",
            "detected": f"detected cells, at most the {reachable} reachable ones",
            "none": "no cell",
        }[self.needs.cells]
        return Step(
            "angles",
            method,
            Work(n_cells * n_points, 16 * n_cells * self.e, n_cells * operations),
            Work(n_all * plane, self.itemsize * n_all * (self.all + plane), n_all * full),
        )

    def echo(self, scenario: Scenario) -> Step:
        """Echoes of all scatterers in closed form, once a scene: those of one speed are summed first."""
        n_echoes, n_speeds = len(scenario.scatterers), np.unique(scenario.scatterers.velocity).size

        def work(n_range: int, n_doppler: int, itemsize: int) -> Work:
            n_cells = n_range * n_doppler * self.all
            sums = n_range * self.all * n_echoes + n_cells * n_speeds
            return Work(n_cells, n_cells * itemsize, 8 * sums)

        computed = work(self.r, self.d, np.dtype(np.complex128).itemsize)
        return Step("echo", "cells of the gate", computed, work(self.n, self.m, self.itemsize))

    def noise(self) -> Step:
        """Noise of a trial, two normal numbers a cell; every SNR scales the same ones."""
        n_cells, n_all = self.r * self.d * self.all, self.n * self.m * self.all
        computed = Work(n_cells, n_cells * np.dtype(np.complex128).itemsize, 2 * n_cells)
        return Step("noise", "cells of the gate", computed, Work(n_all, n_all * self.itemsize, 2 * n_all))


def _fft_operations(n: int) -> int:
    """Operations a point of an FFT of a length."""
    return round(5 * math.log2(max(n, 2)))
