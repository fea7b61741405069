"""Doppler lines: the speeds that a range-Doppler map holds, and its separation into layers of one speed.

Objects that move as one have one speed, so that a map of many scatterers holds
few Doppler lines. Behind the transform over symbols a line is known up to one
amplitude for each range bin and element, and lines are told apart by all of
their bins. Cells, which show one bin, mix the echoes of neighbouring speeds.

1. MUSIC along Doppler on a few neighbouring range bins, with all elements as
   snapshots. All lines are referred to the middle of the symbols: they are
   real, and so are their covariances.
2. Places that several range bins agree on are lines, the strongest first. In
   range bins that show a line, it has the place that is seen there.
3. In each range bin the map is fitted by all lines that can be told apart,
   first by those that the bin shows itself. Each has a power there, found by
   expectation maximisation: a line that is absent takes nothing.

Cost of R range bins, D Doppler bins, M elements and k lines: R D² M for the
covariances, R D³ for their eigenvectors, R k³ for the powers.

Fails where speeds are spread by more than a fraction of a bin, as of a turning
car: a few lines then stand for all, and some of their echoes stay in the map.

References
----------
Schmidt, "Multiple emitter location and signal parameter estimation", IEEE
Trans. AP 34 (1986).
Tipping, "Sparse Bayesian learning and the relevance vector machine", J. Machine
Learning Research 1 (2001), for the powers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from isacbench.dsp.angles.eigenpairs import separated_order, with_rounding
from isacbench.dsp.angles.line_subspaces import music_null_spectrum
from isacbench.dsp.angles.model_order import noise_edge, noise_order
from isacbench.dsp.angles.peaks import line_peaks
from isacbench.dsp.array_types import Complex, Floats, Integers, Mask
from isacbench.dsp.rangedoppler import GatedMap
from isacbench.model.kernels import dirichlet_slopes

RANGE_SIDE = 1
"""Neighbouring range bins to either side whose snapshots are joined: they hold echoes of the same objects."""

N_JOINED = 2 * RANGE_SIDE + 1
"""Range bins whose snapshots are joined."""

MOST_LOCAL_LINES = 6
"""Most lines sought in neighbouring range bins."""

GRID_STEP_BINS = 0.05
"""Step of the null spectrum: a parabola places the minima of lines half a bin apart to a tenth of it."""

LARGEST_NULL = 0.3
"""Largest null spectrum of a line; 1 in empty places."""

EDGE_MARGIN = 1.2
"""Factor on the largest eigenvalue of noise: it fluctuates, and the noise power is an estimate."""

ONE_LINE_BINS = 0.12
"""Distance of places in different range bins that are one line."""

RESOLVED_BINS = 0.35
"""Least distance of two lines: nearer ones would be told apart by their noise and misfit alone."""

LEAST_RANGES = N_JOINED
"""Range bins that must agree on a line: as many as share their snapshots."""

DYNAMIC_RANGE_DB = 33.0
"""Range below the strongest line in which others are no misfit of it."""

FIT_LOADING = 1e-6
"""Loading of the lines of a few range bins: minima a step apart must not make their equations singular."""

POWER_STEPS = 4
"""Steps of the expectation maximisation: after two, absent lines are below the noise."""

LEAST_POWER = 1e-6
"""Least power of a line over that of noise."""


class _Places(NamedTuple):
    """Places of lines in range bins: Doppler bins, powers, and indices of the range bins, each (n,)."""

    doppler_bin: Floats
    power: Floats
    row: Integers


@dataclass(frozen=True, eq=False)
class DopplerLayers:
    """A map as the sum of k Doppler lines, each with its layer over range and elements.

    Attributes
    ----------
    lines : ndarray of float64, shape (n_range, k)
        Fractional Doppler bin of each line in every range bin.
    counts : ndarray of bool, shape (n_range, k)
        Mask of the lines that a range bin is separated into.
    kernels : ndarray of complex, shape (n_range, k, n_doppler)
        Unit echo of each line in the Doppler bins of the map.
    layers : ndarray of complex, shape (n_range, k, n_elements)
        Amplitudes of the lines.
    """

    lines: Floats
    counts: Mask
    kernels: Complex
    layers: Complex

    @property
    def home(self) -> Integers:
        """Doppler bins in which the lines peak, shape (n_range, k)."""
        return np.rint(self.lines).astype(np.int64)

    def alone(self, gated: GatedMap, line: int, home: int, n_side: int) -> GatedMap:
        """Take the echoes of all lines but one from the map around a Doppler bin.

        Parameters
        ----------
        gated : GatedMap
            The map that the layers are of.
        line : int
            Index of the line that stays.
        home, n_side : int
            Doppler bin, and bins to either side of it that are wanted.

        Returns
        -------
        GatedMap
            Without the bins that the map lacks. Where its last Doppler bin is
            next to its first, it lacks none.
        """
        gate = gated.gate
        bins = np.arange(home - n_side, home + n_side + 1)
        if gate.wraps[1]:
            columns = (bins - gate.doppler_bins[0]) % gate.shape[1]
        else:
            bins = bins[np.isin(bins, gate.doppler_bins)]
            columns = bins - gate.doppler_bins[0]
        other = np.arange(self.lines.shape[1]) != line
        seen = gated.cells[:, columns]
        echoes = self.kernels[:, other][:, :, columns].transpose(0, 2, 1) @ self.layers[:, other]
        around = replace(
            gate, doppler_bins=bins, reachable_doppler=slice(0, bins.size), wraps=(gate.wraps[0], False)
        )
        return replace(gated, cells=seen - echoes.reshape(seen.shape), gate=around)


def doppler_layers(gated: GatedMap, n_symbols: int, noise: float) -> DopplerLayers:
    """Find the Doppler lines of a map, and separate it into their layers.

    Parameters
    ----------
    gated : GatedMap
        Of a whole frame, without tapers.
    n_symbols : int
        Symbols of the frame.
    noise : float
        Power of white noise per cell and element, above 0.

    Returns
    -------
    DopplerLayers
        Without lines if the map holds none.
    """
    n_range, n_doppler = gated.gate.shape
    bins = gated.gate.doppler_bins
    cells = gated.cells.reshape(n_range, n_doppler, gated.n_elements)
    # Behind these phases the kernels are real.
    phase = np.exp(1j * np.pi * (n_symbols - 1) / n_symbols * bins)
    covariance = cells @ cells.conj().transpose(0, 2, 1) / gated.n_elements
    real_covariance = (phase[:, None] * covariance * phase.conj()).real.astype(np.float64)
    lines, counts = _find_lines(gated, real_covariance, n_symbols, noise)
    kernels = _kernels(bins, lines, n_symbols)
    filters = _separating_filters(kernels * counts[:, :, None], real_covariance, noise) * phase
    layers = filters.astype(cells.dtype) @ cells
    return DopplerLayers(lines, counts, (kernels * phase.conj()).astype(cells.dtype), layers)


def _find_lines(gated: GatedMap, covariance: Floats, n_symbols: int, noise: float) -> tuple[Floats, Mask]:
    """Lines (n_range, k) that several range bins agree on, and the mask of those that count in each.

    The covariances (n_range, n_doppler, n_doppler) are those of the Doppler bins over all elements,
    referred to the middle of the symbols.
    """
    places, n_range = _local_places(gated, covariance, n_symbols, noise), gated.gate.shape[0]
    free = places.power > places.power.max(initial=0) * 10 ** (-DYNAMIC_RANGE_DB / 10)
    lines, powers = [], []
    while free.any():
        first = int(np.argmax(np.where(free, places.power, 0)))
        line = _settled(places, free, places.doppler_bin[first])
        mine = free & (np.abs(places.doppler_bin - line) < ONE_LINE_BINS)
        mine[first] = True
        free &= ~mine
        if np.unique(places.row[mine]).size < LEAST_RANGES:
            continue
        doppler_bin, power = np.full(n_range, line), np.zeros(n_range)
        # Of several places in a range bin the strongest is written last.
        seen = np.flatnonzero(mine)[np.argsort(places.power[mine], kind="stable")]
        doppler_bin[places.row[seen]], power[places.row[seen]] = places.doppler_bin[seen], places.power[seen]
        lines.append(doppler_bin)
        powers.append(power)
    every, shown = (np.array(columns).reshape(-1, n_range).T for columns in (lines, powers))
    return every, _told_apart(every, shown)


def _told_apart(lines: Floats, power: Floats) -> Mask:
    """Mask (n_range, k) of the lines that count in each range bin.

    They are at least `RESOLVED_BINS` apart, first those that the range bin shows itself, the strongest first.
    """
    counts = np.zeros(lines.shape, dtype=np.bool_)
    every_row = np.arange(len(lines))
    for line in np.argsort(-power, axis=1, kind="stable").T:
        near = np.abs(lines - lines[every_row, line][:, None]) < RESOLVED_BINS
        counts[every_row, line] = ~(counts & near).any(axis=1)
    return counts


def _local_places(gated: GatedMap, covariance: Floats, n_symbols: int, noise: float) -> _Places:
    """Minima of MUSIC's null spectrum along Doppler for every reachable range bin, and their powers."""
    gate, n_doppler = gated.gate, covariance.shape[1]
    rows = np.arange(gate.shape[0])[gate.reachable_range]
    joined = np.zeros((rows.size, n_doppler, n_doppler))
    for side in range(-RANGE_SIDE, RANGE_SIDE + 1):
        joined += covariance[np.clip(rows + side, 0, gate.shape[0] - 1)] / N_JOINED
    values, vectors = np.linalg.eigh(joined)
    pairs = with_rounding(values[:, ::-1], vectors[:, :, ::-1])
    edge = EDGE_MARGIN * noise_edge(n_doppler, 2 * gated.n_elements * N_JOINED)
    largest_noise = np.maximum(edge * noise, pairs.rounding)
    order = np.minimum(noise_order(pairs.values, largest_noise[:, None]), MOST_LOCAL_LINES)
    order = np.where(pairs.values[:, 0] > largest_noise, separated_order(pairs.rotation, order), 0)
    slowest, fastest = gate.doppler_bins[gate.reachable_doppler][[0, -1]]
    grid = np.arange(slowest - 0.5, fastest + 0.5 + GRID_STEP_BINS / 2, GRID_STEP_BINS)
    steering = _kernels(gate.doppler_bins, grid, n_symbols)
    steering *= np.sqrt(n_doppler) / np.linalg.norm(steering, axis=1, keepdims=True)
    null = music_null_spectrum(pairs.vectors, order, steering.T) / n_doppler
    peaks = line_peaks(-null, grid, order, null < LARGEST_NULL)
    parts = [
        _fitted(joined[index], peaks.place[index, peaks.found[index]], row, n_symbols, gate.doppler_bins)
        for index, row in enumerate(rows)
    ]
    return _Places(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _fitted(covariance: Floats, lines: Floats, row: int, n_symbols: int, bins: Integers) -> _Places:
    """Powers of the lines of one covariance by least squares."""
    kernels = _kernels(bins, lines, n_symbols)
    loading = FIT_LOADING * np.eye(lines.size)
    filters = np.linalg.solve(kernels @ kernels.T + loading, kernels)
    power = np.einsum("ld,de,le->l", filters, covariance, filters)
    return _Places(lines, power, np.full(lines.size, row))


def _settled(places: _Places, free: Mask, line: float) -> float:
    """Mean place, weighted by power, of the free places around it."""
    for _ in range(5):
        near = free & (np.abs(places.doppler_bin - line) < ONE_LINE_BINS)
        if near.any():
            line = float(np.average(places.doppler_bin[near], weights=places.power[near]))
    return line


def _separating_filters(kernels: Floats, covariance: Floats, noise: float) -> Floats:
    """Linear estimators (n_range, k, n_doppler) of least error of the lines' amplitudes in each range bin.

    Every line has a power of its own in a range bin, found by expectation
    maximisation from the powers of its matched filter. Lines whose kernel is 0
    get nothing.
    """
    adjoint = kernels.transpose(0, 2, 1)
    gram, identity = kernels @ adjoint, np.eye(kernels.shape[1])
    matched = kernels @ covariance @ adjoint
    power = np.maximum(np.diagonal(matched, axis1=1, axis2=2), LEAST_POWER * noise)
    for _ in range(POWER_STEPS):
        inverse = np.linalg.inv(gram + noise / power[:, :, None] * identity)
        fitted = inverse @ matched @ inverse
        power = np.diagonal(fitted + noise * inverse, axis1=1, axis2=2)
        power = np.maximum(power, LEAST_POWER * noise)
    return np.linalg.inv(gram + noise / power[:, :, None] * identity) @ kernels


def _kernels(bins: Integers, lines: Floats, n_symbols: int) -> Floats:
    """Real kernels (..., n_doppler) of lines (...), 1 at the line itself."""
    return dirichlet_slopes(bins - lines[..., None], n_symbols)[0]
