"""Cases of maps that no scene makes: constant, zero, subnormal, a single cell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from isacbench.checking.stress.cases.estimator_case import EstimatorCase
from isacbench.checking.stress.cases.resolved_shots import NARROW, Layout, observed, with_cells
from isacbench.checking.stress.promises.image_promises import (
    BLAS_KERNELS,
    EVERY,
    LAYOUT,
    NO_FALSE_POINT,
    THREADS,
)
from isacbench.checking.stress.spaces import choice, real

if TYPE_CHECKING:
    from isacbench.checking.contract.small_scenes import Shot
    from isacbench.checking.stress.case import Promise
    from isacbench.checking.stress.promises.image_promises import Imaging

SMALLEST = 5e-324


@dataclass(frozen=True)
class Blank(EstimatorCase):
    """Cells of one value, of the smallest number that there is, or all but a cell or an element zero."""

    name: ClassVar[str] = "map"
    fixed: ClassVar = (
        {"filled": "zeros"},
        *(
            {"filled": filled, "exponent": exponent}
            for filled in ("constant", "one_cell", "one_element", "checkers", "loud_element")
            for exponent in (-150.0, 0.0, 150.0)
        ),
        {"filled": "subnormal"},
        {"filled": "subnormal_cell"},
    )

    filled: str = choice(
        "zeros",
        "constant",
        "subnormal",
        "subnormal_cell",
        "one_cell",
        "one_element",
        "checkers",
        "loud_element",
    )
    exponent: float = real(-150.0, 150.0, 0.0)

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """A cloud; an empty one of zeros."""
        empty = (NO_FALSE_POINT,) if self.filled == "zeros" else ()
        return *EVERY, *empty, THREADS, BLAS_KERNELS, LAYOUT

    def shot(self, seed: int) -> Shot:
        """Fill the cells of a gate."""
        shot = observed([], seed=seed, layout=Layout(region=NARROW))
        cells = np.zeros_like(shot.seen.cells)
        level = 10.0**self.exponent
        middle = cells.shape[0] // 2, cells.shape[1] // 2
        match self.filled:
            case "constant":
                cells[:] = level
            case "subnormal":
                cells[:] = SMALLEST
            case "subnormal_cell":
                cells[middle] = SMALLEST
            case "one_cell":
                cells[middle] = level
            case "one_element":
                cells[*middle, 1, 1] = level
            case "loud_element":
                cells[:] = observed([], 0.0, seed, Layout(region=NARROW)).seen.cells
                cells[*middle, 1, 1] = level
            case "checkers":
                cells[::2, ::2] = cells[1::2, 1::2] = level
        return with_cells(shot, cells)
