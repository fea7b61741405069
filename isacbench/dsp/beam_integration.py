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
from numpy.typing import ArrayLike, NDArray
from scipy.special import gammaincc, gammaln

from isacbench.checked_arrays import Complex, Floats, Mask, parts_of
from isacbench.dsp.angles.peaks import PERIOD
from isacbench.dsp.detection import Detection, Detector, detect_listed
from isacbench.dsp.rangedoppler import CACHED_SAMPLES, TaperedMap
from isacbench.dsp.windows import reach, taper
from isacbench.model.kernels import steering
from isacbench.model.region import Interval

BEAMS_A_CELL = 2
"""Beams a Rayleigh cell along each axis: halfway between two of them an echo keeps 81 % of its power."""

DRAWS = 2048
"""Draws of noise: the number of independent beams is right to 1 %."""

DRAWN_OUTPUTS = 2**20
"""Outputs of beams that are drawn at once: 16 MiB."""

ROUNDING = 1e-9
"""Relative margin for rounding."""

RARELY = -5.0
"""Logarithm of a share of false alarms that does not count."""

IN_PHASE = 4.0
"""Leakage in a beam over that in the mean power: of two echoes it may add up in phase."""

LEAST_LOG = -600.0
"""Logarithm of a rate below which the incomplete gamma function underflows."""


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
    level = float(_beam_level(np.log(pfa), n_beams))
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


def _beam_level(log_rate: ArrayLike, n: float) -> Floats:
    """Level that unit noise exceeds in the strongest of n independent beams, from the logarithm of a rate."""
    log_rate = np.asarray(log_rate)
    rate = np.exp(np.clip(log_rate, LEAST_LOG, -ROUNDING))
    # Of small rates, that of each beam is the n-th part.
    few: Floats = -np.log(-np.expm1(np.log1p(-rate) / n))
    return np.where(log_rate > LEAST_LOG, few, np.log(n) - log_rate)


def _log_rate(level: Floats, looks: int) -> Floats:
    """Logarithm of the rate at which the mean of as many noise powers, of mean 1, exceeds a level."""
    with np.errstate(divide="ignore"):
        exact: Floats = np.log(gammaincc(looks, looks * level))
    # Where the rate underflows, the first term of its continued fraction is as good.
    total = looks * np.maximum(level, 1 + 1 / looks)
    beyond: Floats = looks * np.log(total) - total - gammaln(looks) - np.log(total - looks + 1)
    return np.where(exact > LEAST_LOG, exact, beyond)


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

    A detector compares the mean power of the elements with a threshold, which
    white noise exceeds at some rate. The threshold here is the level that noise
    exceeds at the same rate in the strongest beam. So the false-alarm rate is
    the detector's, in any window and at edges. Where strong cells raise the detector's
    threshold, their sidelobes are detected no more often than in the mean power.

    Attributes
    ----------
    detector : Detector
        Of the mean power of all elements.
    tapered : TaperedMap
        Map of which beams are formed.
    beams : Beams
    noise : float
        Power of white noise per cell and element.
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
        threshold_rate, own_rate = _log_rate(np.stack([found.threshold, mean]) / self.noise, looks)
        levels = self.noise * _beam_level(threshold_rate, independent_beams(self.beams, self.pfa))
        alone = mean <= found.threshold
        threshold = np.maximum(levels, looks * self.leakage * np.where(alone, IN_PHASE, 1))
        power, beam = self._strongest(rows, columns)
        # Many echoes in a cell add up in its mean power alone; it counts where it cannot be noise.
        clear = own_rate < np.log(self.pfa) + RARELY
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
        """Power and number of the strongest beam of cells, whose rows ascend.

        Beams are formed before the map is tapered: most often there are fewer of them than elements.
        """
        tapered, (in_range, in_doppler) = self.tapered, self.tapered.windows
        first, last = columns.min(initial=0), columns.max(initial=0)
        cells = tapered.untapered.cells[:, first : last + 2 * reach(in_doppler) + 1]
        n_more = 2 * reach(in_range)
        highest, beam = np.empty(rows.size), np.empty(rows.size, dtype=np.intp)
        n_values = len(cells[0]) * max(self.beams.n_beams, tapered.aperture.n_elements)
        for some in parts_of(tapered.gate.shape[0], 2 * CACHED_SAMPLES // n_values):
            here = slice(*np.searchsorted(rows, (some.start, some.stop)))
            if here.start == here.stop:
                continue
            block = cells[some.start : some.stop + n_more].astype(tapered.dtype, copy=False)
            outputs = taper(taper(self.beams.outputs(block), in_range, axis=0), in_doppler, axis=1)
            listed = outputs[rows[here] - some.start, columns[here] - first]
            power = listed.real**2 + listed.imag**2
            beam[here] = power.argmax(axis=1)
            highest[here] = power.max(axis=1)
        return highest, beam
