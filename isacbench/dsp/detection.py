"""Detections: the result of a CFAR detector, and the contract of everything that returns one."""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, cast, runtime_checkable

from isacbench.display import Description, Displayed, range_text
from isacbench.files.escaping import plural

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True, eq=False, repr=False)
class Detection(Displayed):
    """Result of a detector; every array has the map's shape, or (n,) where n cells were listed.

    Attributes
    ----------
    mask : ndarray of bool
        Cells whose power exceeds their threshold.
    threshold : ndarray of float64
        Threshold of each cell, same unit as the power.
    noise : ndarray of float64
        Noise power that the detector estimates around each cell.
    """

    mask: NDArray[np.bool_]
    threshold: NDArray[np.float64]
    noise: NDArray[np.float64]

    def _description(self) -> Description:
        import numpy as np  # which commands that only look up plugins do without

        mask = np.asarray(self.mask)
        n_detected = np.count_nonzero(mask)
        share = f" ({100 * n_detected / mask.size:.3g} %)" if mask.size else ""
        return Description(
            f"Detection: {n_detected} of {plural(mask.size, 'cell')} detected{share}",
            {
                "map": " x ".join(map(str, mask.shape)),
                "threshold": range_text(self.threshold),
                "noise": range_text(self.noise),
            },
        )


@runtime_checkable
class Detector(Protocol):
    """A CFAR detector: a frozen dataclass of its parameters.

    `detect` may take a third argument, ``cells``: what to test instead of the
    whole map, as `numpy.nonzero` gives it. Those that do are asked for no more
    than is needed (`detect_listed`).

    Attributes
    ----------
    name : str
        Class attribute, the name it is registered under.
    pfa : float
        Probability of false alarm per cell in homogeneous noise.
    """

    name: ClassVar[str]

    @property
    def pfa(self) -> float:
        """Probability of false alarm per cell."""

    def detect(self, power: NDArray[np.floating], looks: int = 1) -> Detection:
        """Test every cell of a power map.

        Parameters
        ----------
        power : ndarray of real numbers
            Power map of any rank.
        looks : int, default 1
            Independent noise powers that each cell averages.
        """


def detect_listed(
    detector: Detector, power: NDArray[np.floating], looks: int, cells: tuple[NDArray[np.intp], ...]
) -> Detection:
    """Test listed cells of a power map, and only those if the detector takes a list.

    Parameters
    ----------
    detector : Detector
        If its `detect` does not take ``cells``, all cells are tested and the
        listed ones picked.
    power : ndarray of float64
        Power map of any rank.
    looks : int
        Independent noise powers that each cell averages.
    cells : tuple of ndarray of int, each shape (n,)
        Cells to test, as `numpy.nonzero` gives them.

    Returns
    -------
    Detection
        Arrays of shape (n,).
    """
    if "cells" in inspect.signature(detector.detect).parameters:
        return cast("Detection", cast("Any", detector).detect(power, looks, cells=cells))
    whole = detector.detect(power, looks)
    return Detection(whole.mask[cells], whole.threshold[cells], whole.noise[cells])
