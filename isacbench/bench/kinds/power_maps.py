"""Synthetic power maps: the situations in which CFAR detectors differ.

A map is tiled with sites, each with its own target, so that one call of a
detector is about a hundred experiments. Targets and interferers fluctuate (Swerling
I: complex Gaussian, as the noise), have the same mean power and fill one cell.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from isacbench.checked_arrays import Complex, Mask
from isacbench.choices import MapName
from isacbench.model.echo import random_stream, white_gaussian

SITE = 32
"""Cells of a site along range and along Doppler."""

N_SITES = 4, 32
"""Sites of a map along range and along Doppler."""

SHAPE = N_SITES[0] * SITE, N_SITES[1] * SITE
NONE = np.zeros(SHAPE, dtype=np.bool_)

REACH = 8
"""Distance from all echoes in cells beyond which a detector's whole window holds noise only."""

NEIGHBOURS = 2, 4
"""Distances of a second target or an interferer in cells: in the window, outside the guard cells."""

EDGE_DB = 15.0
"""Clutter-to-noise ratio in dB."""

EDGE_DISTANCE = 3
"""Distance in cells from a target in noise to the first cell of clutter."""

EDGE_CELLS = 4
"""Cells of clutter along range that count as its edge: half a window of the paper's size."""

N_INTERFERERS = 6


@dataclass(frozen=True, eq=False)
class PowerMap:
    """Noise and echoes of a map, from which its power at any SNR follows; arrays (n_range, n_doppler).

    Attributes
    ----------
    noise : ndarray of complex128
        Noise of power 1, or clutter and noise together where there is clutter.
    echo : ndarray of complex128
        Echoes of mean power 1, zero where there is none.
    targets : ndarray of bool
        Cells that should be detected.
    clear : ndarray of bool
        Cells without an echo in which false alarms are counted.
    """

    noise: Complex
    echo: Complex
    targets: Mask
    clear: Mask

    def power(self, snr_db: float) -> NDArray[np.float64]:
        """Power of every cell, with targets of a mean power over that of noise."""
        cells = self.noise + 10 ** (snr_db / 20) * self.echo
        power: NDArray[np.float64] = cells.real**2 + cells.imag**2
        return power


Layout = tuple[NDArray[np.float64] | float, Mask, Mask, Mask]
"""Mean power of noise and clutter, then cells of targets, of interferers, and clear ones."""


def draw_power_map(name: MapName, trial: int, seed: int) -> PowerMap:
    """Draw a map.

    ``homogeneous``: noise, and one target a site; false alarms are counted out of reach of targets.
    ``clutter-edge``: half of the map is 15 dB of clutter, targets lie in noise three cells before it; false
    alarms are counted in the first four cells of clutter. ``close-targets``: two targets two to four cells
    apart. ``interferers``: six of them two to four cells around each target. In both, false alarms are
    counted up to four cells around targets.
    """
    background, targets, interferers, clear = MAPS[name](random_stream(name, trial, seed, "layout"))
    noise = white_gaussian(random_stream(name, trial, seed), SHAPE) * np.sqrt(background)
    echo = white_gaussian(random_stream(name, trial, seed, "echo"), SHAPE)
    return PowerMap(noise, np.where(targets | interferers, echo, 0), targets, clear)


def near(mask: Mask, distance: int) -> Mask:
    """Mark the cells at most so far from those of a mask; a diagonal step counts as one."""
    return np.asarray(ndimage.maximum_filter(mask, size=2 * distance + 1, mode="constant"), dtype=np.bool_)


def _homogeneous(rng: np.random.Generator) -> Layout:
    targets = _mask(_centres())
    return 1.0, targets, NONE, ~near(targets, REACH)


def _clutter_edge(rng: np.random.Generator) -> Layout:
    rows, columns = _centres()
    clutter = np.broadcast_to(np.arange(SHAPE[0])[:, None] // SITE % 2 == 1, SHAPE)
    before = rows // SITE % 2 == 0
    targets = _mask(((rows[before] // SITE + 1) * SITE - EDGE_DISTANCE, columns[before]))
    edge = clutter & ~np.roll(clutter, EDGE_CELLS, axis=0)
    return np.where(clutter, 10 ** (EDGE_DB / 10), 1.0), targets, NONE, edge & ~near(targets, REACH)


def _close_targets(rng: np.random.Generator) -> Layout:
    targets = _mask(_centres()) | _around(rng, 1)
    return 1.0, targets, NONE, near(targets, NEIGHBOURS[1]) & ~targets


def _interferers(rng: np.random.Generator) -> Layout:
    targets, interferers = _mask(_centres()), _around(rng, N_INTERFERERS)
    return 1.0, targets, interferers, near(targets, NEIGHBOURS[1]) & ~targets & ~interferers


MAPS: dict[MapName, Callable[[np.random.Generator], Layout]] = {
    "homogeneous": _homogeneous,
    "clutter-edge": _clutter_edge,
    "close-targets": _close_targets,
    "interferers": _interferers,
}


def _centres() -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Row and column of the middle of every site."""
    rows, columns = np.indices(N_SITES).reshape(2, -1) * SITE + SITE // 2
    return rows, columns


def _mask(cells: tuple[NDArray[np.intp], NDArray[np.intp]]) -> Mask:
    """Mask of some cells."""
    mask = np.zeros(SHAPE, dtype=np.bool_)
    mask[cells] = True
    return mask


def _around(rng: np.random.Generator, n: int) -> Mask:
    """Mask of `n` different cells around the middle of every site."""
    nearest, farthest = NEIGHBOURS
    offsets = np.indices((2 * farthest + 1,) * 2).reshape(2, -1).T - farthest
    offsets = offsets[np.abs(offsets).max(axis=1) >= nearest]
    rows, columns = _centres()
    order = rng.permuted(np.tile(np.arange(len(offsets)), (rows.size, 1)), axis=1)[:, :n]
    chosen = offsets[order]
    return _mask((rows[:, None] + chosen[..., 0], columns[:, None] + chosen[..., 1]))
