"""Detection of cells by their strongest beam: echoes add up over the elements before they are detected.

Beams towards all directions of a region, two a Rayleigh cell along u and along
w, are correlated. Noise exceeds a level in the strongest of them as often as in
a smaller number of independent beams, which is counted on draws of noise.

References
----------
Frigessi and Vercellis, "An analysis of Monte Carlo algorithms for counting
problems", Calcolo 22 (1985), for the probability of a union of events.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import ceil, prod
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainccinv

from isacbench.checked_arrays import Complex, Floats, Mask, parts_of
from isacbench.dsp.detection import Detection, Detector, detect_listed
from isacbench.dsp.rangedoppler import CACHED_SAMPLES, TaperedMap
from isacbench.dsp.windows import reach, taper
from isacbench.model.kernels import PERIOD, steering
from isacbench.model.region import Interval

BEAMS_A_CELL = 2
"""Beams a Rayleigh cell along each axis: halfway between two of them an echo keeps 81 % of its power."""

DRAWS = 2048
"""Draws of noise: the number of independent beams is right to 1 %."""

DRAWN_OUTPUTS = 2**20
"""Outputs of beams that are drawn at once: 16 MiB."""

ROUNDING = 1e-9
"""Relative margin for rounding."""

RARELY = 0.01
"""Share of the false alarms that cells may add whose mean power alone is too high for noise."""

NOISE_MARGIN = 0.05
"""By how much more than white noise a detector measures where there are echoes around a cell, too."""

IN_PHASE = 4.0
"""Leakage in a beam over that in the mean power: of two echoes it may add up in phase."""


@dataclass(frozen=True)
class Beams:
    """Beams of P x Q elements towards the directions of a region.

    Attributes
    ----------
    shape : (int, int)
        Elements P and Q.
    limits : ((float, float), (float, float))
        Lowest and highest u, and w.
    """

    shape: tuple[int, int]
    limits: tuple[Interval, Interval]

    @cached_property
    def cosines(self) -> list[Floats]:
        """Direction cosines u of the beams, and w: equidistant, each u with each w."""
        return [_spread(n, *limits) for n, limits in zip(self.shape, self.limits, strict=True)]

    @property
    def n_beams(self) -> int:
        """Number of beams."""
        return prod(cosine.size for cosine in self.cosines)

    def outputs(self, cells: Complex) -> Complex:
        """Outputs (..., beams), in which noise keeps its power, of cells (..., P, Q)."""
        towards_u, towards_w = (filters.astype(cells.dtype) for filters in self._filters)
        # One product along each axis: one for each cell takes longer.
        along_w = (cells.reshape(-1, self.shape[1]) @ towards_w.T).reshape(-1, self.shape[0], len(towards_w))
        beams: Complex = along_w.transpose(0, 2, 1).reshape(-1, self.shape[0]) @ towards_u.T
        return beams.reshape(*cells.shape[:-2], -1)

    def directions(self, beam: NDArray[np.intp]) -> tuple[Floats, Floats]:
        """Direction cosines u and w of beams, by their numbers."""
        u, w = self.cosines
        along_w, along_u = np.divmod(beam, u.size)
        return u[along_u], w[along_w]

    def matched(self, beam: NDArray[np.intp]) -> Complex:
        """Echoes (n, P, Q) of unit energy that beams are matched to, by their numbers."""
        along_u, along_w = self._filters
        row, column = np.divmod(beam, len(along_u))
        return along_u[column].conj()[:, :, None] * along_w[row].conj()[:, None, :]

    @cached_property
    def _filters(self) -> list[Complex]:
        """Matched filters (beams, elements) of unit energy along u, and along w."""
        lines = zip(self.shape, self.cosines, strict=True)
        return [steering(n, cosine).conj() / np.sqrt(n) for n, cosine in lines]


@lru_cache(maxsize=64)
def independent_beams(beams: Beams, pfa: float) -> float:
    """Count the independent beams that noise raises above a level as often as the strongest of all beams.

    Let a beam drawn at random be above the level, and N be the number of those
    that then are. The probability that any of n beams is above it is n times
    that of one, times the mean of 1 / N.

    Parameters
    ----------
    pfa : float
        Rate at which noise raises the strongest beam above the level.
    """
    random, n_beams = np.random.default_rng(0), beams.n_beams
    level = _beam_level(pfa, n_beams)
    share = 0.0
    for some in parts_of(DRAWS, DRAWN_OUTPUTS // n_beams):
        drawn = np.arange(some.start, some.stop) % n_beams
        n, each = drawn.size, np.arange(drawn.size)
        parts = random.standard_normal((2, n, *beams.shape)) / np.sqrt(2)
        above, turn = random.exponential(size=n), np.exp(2j * np.pi * random.random(n))
        outputs, responses = beams.outputs(parts[0] + 1j * parts[1]), beams.outputs(beams.matched(drawn))
        raised = np.sqrt(level + above) * turn - outputs[each, drawn]
        seen = outputs + responses * raised[:, None]
        share += np.sum(1 / np.count_nonzero(np.abs(seen) ** 2 > level * (1 - ROUNDING), axis=1)) / DRAWS
    union = min(n_beams * np.exp(-level) * share, 1 - ROUNDING)
    return float(np.log1p(-union) / np.log1p(-np.exp(-level)))


def _spread(n: int, lower: float, upper: float) -> Floats:
    """Cosines between two limits, at most half a beam beyond them; or those of the whole circle."""
    step = PERIOD / n / BEAMS_A_CELL
    n_beams = ceil((upper - lower) / step * (1 - ROUNDING)) + 1
    if n_beams > n * BEAMS_A_CELL:
        return np.linspace(-1, 1, n * BEAMS_A_CELL, endpoint=False)
    middle, half = (lower + upper) / 2, step * (n_beams - 1) / 2
    return np.linspace(middle - half, middle + half, n_beams)


def _beam_level(rate: float, n: float) -> float:
    """Level that noise of unit power exceeds at a rate in the strongest of n independent beams."""
    return float(-np.log(-np.expm1(np.log1p(-rate) / n)))


@dataclass(frozen=True, eq=False, repr=False)
class BeamDetection(Detection):
    """A detection on beams: thresholds are those of the strongest beam of each cell.

    Attributes
    ----------
    power : ndarray of float64
        Power of the strongest beam; or the mean power, on the scale of these thresholds.
    beam : ndarray of int64
        Its number.
    alone : ndarray of bool
        Cells whose mean power does not exceed its own threshold.
    """

    power: Floats
    beam: NDArray[np.intp]
    alone: Mask


@dataclass(frozen=True, eq=False)
class BeamIntegration:
    """Detector of the cells whose strongest beam exceeds its threshold.

    A detector's threshold on the mean power of the elements, which white noise
    exceeds at the rate `pfa`, tells how strong the noise around a cell is. In the
    strongest beam noise exceeds another level at that rate. Around strong cells
    the detector measures their echoes, too, which have directions and are as strong in
    a beam as in all elements together: by as much the level rises.

    Attributes
    ----------
    detector : Detector
        Of the mean power of all elements.
    tapered : TaperedMap
        Map of which beams are formed.
    beams : Beams
        Towards the directions of the region.
    noise : float
        Power of white noise per cell and element. What the detector measures beyond it are echoes.
    leakage : float
        Power per element that the strongest cells may show elsewhere: a beam must exceed it, and `IN_PHASE`
        times as much where the mean power does not exceed its threshold.
    """

    name: ClassVar[str] = "beams"

    detector: Detector
    tapered: TaperedMap
    beams: Beams
    noise: float
    leakage: float

    @property
    def pfa(self) -> float:
        """Probability of false alarm per cell in white noise."""
        return self.detector.pfa

    def detect(
        self,
        mean_power: NDArray[np.floating[Any]],
        looks: int = 1,
        cells: tuple[NDArray[np.intp], ...] | None = None,
    ) -> BeamDetection:
        """Test cells.

        Parameters
        ----------
        mean_power : ndarray of float64, shape (n_range, n_doppler)
            Mean power of the elements.
        looks : int
            Number of elements.
        cells : tuple of ndarray of int, optional
            Cells to test, as `numpy.nonzero` gives them; default: all cells.

        Returns
        -------
        BeamDetection
        """
        shape = mean_power.shape if cells is None else cells[0].shape
        rows, columns = np.indices(mean_power.shape).reshape(2, -1) if cells is None else cells
        mean = mean_power[rows, columns]
        found = detect_listed(self.detector, mean_power, looks, (rows, columns))
        # Noise around each cell, of which the detector's threshold is the level at its rate.
        around = found.threshold / (gammainccinv(looks, self.pfa) / looks)
        echoes = np.maximum(around - (1 + NOISE_MARGIN) * self.noise, 0)
        n_beams = independent_beams(self.beams, self.pfa)
        level = _beam_level(self.pfa, n_beams) * around + looks * echoes
        alone = mean <= found.threshold
        threshold = np.maximum(level, looks * self.leakage * np.where(alone, IN_PHASE, 1))
        power, beam = self._strongest(rows, columns)
        # Many echoes in a cell add up in its mean power alone; it counts where it cannot be noise.
        clear = looks * mean > gammainccinv(looks, RARELY * self.pfa) * around
        exceeds = mean[clear] / np.maximum(found.threshold[clear], self.leakage)
        power[clear] = np.maximum(power[clear], exceeds * threshold[clear])
        return BeamDetection(
            (power > threshold).reshape(shape),
            threshold.reshape(shape),
            found.noise.reshape(shape),
            power.reshape(shape),
            beam.reshape(shape),
            alone.reshape(shape),
        )

    def _strongest(
        self, rows: NDArray[np.intp], columns: NDArray[np.intp]
    ) -> tuple[Floats, NDArray[np.intp]]:
        """Power and number of the strongest beam of cells.

        Beams are formed before the map is tapered: most often there are fewer of them than elements.
        """
        tapered, (in_range, in_doppler) = self.tapered, self.tapered.windows
        first, last = columns.min(initial=0), columns.max(initial=0)
        cells = tapered.untapered.cells[:, first : last + 2 * reach(in_doppler) + 1]
        n_more = 2 * reach(in_range)
        highest, beam = np.empty(rows.size), np.empty(rows.size, dtype=np.intp)
        ascending = np.argsort(rows, kind="stable")
        n_values = len(cells[0]) * max(self.beams.n_beams, tapered.aperture.n_elements)
        for some in parts_of(tapered.gate.shape[0], 2 * CACHED_SAMPLES // n_values):
            first_cell, end = np.searchsorted(rows, (some.start, some.stop), sorter=ascending)
            here = ascending[first_cell:end]
            if not here.size:
                continue
            block = cells[some.start : some.stop + n_more].astype(tapered.dtype, copy=False)
            outputs = taper(taper(self.beams.outputs(block), in_range, axis=0), in_doppler, axis=1)
            listed = outputs[rows[here] - some.start, columns[here] - first]
            power = listed.real**2 + listed.imag**2
            beam[here] = power.argmax(axis=1)
            highest[here] = power.max(axis=1)
        return highest, beam
