"""A recorded frame of a scenario, simulated block by block: the whole cube, written without being held.

Its noise is white over the whole frame, and in the cells of the gate it is the
draw that `isacbench.observe` adds there: to each block of a white frame is
added what the canonical noise of the gate differs from the transform of that
frame. The transforms are unitary, so that this changes those cells and no
others. An image of the cube is then the image of the observation.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np

from isacbench.checked_arrays import Complex
from isacbench.cores import available_cores, one_blas_thread
from isacbench.dsp.partial_dft import doppler_rows, range_rows, transform_block
from isacbench.model.echo import Simulator, random_stream, resource_grid, transmitted_noise, white_gaussian

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from isacbench.model.scene import Scenario

BLOCK_SUBCARRIERS = 16
"""Subcarriers of a block: 15 MB in double precision at the paper's size. The noise follows from it."""


class FrameSimulator:
    """The frame of a scenario that `isacbench.observe` would see with the same SNR, trial and seed.

    Parameters
    ----------
    snr_db : float
        Signal-to-noise ratio Σ|G|²/σ² per resource element and virtual
        element; infinity for no noise.
    trial, seed : int
        Which noise.
    """

    def __init__(self, scenario: Scenario, snr_db: float, trial: int = 0, seed: int = 0) -> None:
        scenario.require_default("a simulated frame", "mimo")
        self._scenario = scenario
        self._trial, self._seed = trial, seed
        simulator = Simulator(scenario)
        self._noise_amplitude = simulator.noise_amplitude(snr_db)
        self._wanted = self._carried = None
        if self._noise_amplitude and scenario.system.noise == "transmitter":
            self._carried = self._noise_amplitude * transmitted_noise(scenario, trial, seed)
        elif self._noise_amplitude:
            self._wanted = simulator.unit_noise(trial, seed)
        system, gate = scenario.system, simulator.gate
        self._along_range = range_rows(gate.range_bins, system.n_subcarriers)
        self._along_doppler = doppler_rows(gate.doppler_bins, system.n_symbols)

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Subcarriers, symbols, P and Q."""
        system, (n_p, n_q) = self._scenario.system, self._scenario.array.shape
        return system.n_subcarriers, system.n_symbols, n_p, n_q

    def blocks(self) -> Iterator[tuple[int, Complex]]:
        """Blocks of consecutive subcarriers."""
        correction, array = self._correction(), self._scenario.array
        # The places of its elements in the frame are those of the frame's elements in the array.
        in_frame = np.ravel_multi_index(tuple(array.in_frame(array.positions).T), array.shape)

        def block(subcarriers: slice) -> Complex:
            grid = resource_grid(self._scenario, self._scenario.array.positions, subcarriers)
            if correction is not None:
                noise = self._white_block(subcarriers)
                noise += self._spread(correction, subcarriers)
                noise *= self._noise_amplitude
                grid += noise
            if self._carried is not None:
                grid *= 1 + self._carried[subcarriers, :, None]
            return grid[:, :, in_frame].reshape(len(grid), *self.shape[1:])

        for subcarriers, made in self._each_block(block):
            yield subcarriers.start, made

    def _correction(self) -> Complex | None:
        """Canonical noise of the gate less what the white frame has there; None without noise."""
        if self._wanted is None:
            return None
        n_range, n_doppler = len(self._along_range), len(self._along_doppler)
        correction = self._wanted.reshape(n_range, n_doppler, -1).copy()

        def share(subcarriers: slice) -> Complex:
            block = self._white_block(subcarriers)
            cells: Complex = transform_block(
                block, self._along_doppler, self._along_range[:, subcarriers]
            ).astype(np.complex128, copy=False)
            return cells

        for _, cells in self._each_block(share):
            correction -= cells
        return correction

    def _spread(self, cells: Complex, subcarriers: slice) -> Complex:
        """Cells of the gate as a block (n, n_symbols, e) of the resource grid: the adjoint transform."""
        n_range, n_doppler, n_elements = cells.shape
        lines = self._along_range[:, subcarriers].conj().T @ cells.reshape(n_range, n_doppler * n_elements)
        grid: Complex = self._along_doppler.conj().T @ lines.reshape(-1, n_doppler, n_elements)
        return grid

    def _white_block(self, subcarriers: slice) -> Complex:
        """Unit noise (n, n_symbols, e) of a block; the same whenever it is asked for."""
        stream = random_stream(self._scenario.name, self._trial, self._seed, "frame", str(subcarriers.start))
        n_elements = len(self._scenario.array.positions)
        shape = subcarriers.stop - subcarriers.start, self._scenario.system.n_symbols, n_elements
        return white_gaussian(stream, shape)

    def _each_block(self, work: Callable[[slice], Complex]) -> Iterator[tuple[slice, Complex]]:
        """Work on all blocks, side by side and in their order, few at a time."""
        n_subcarriers, n_threads = self.shape[0], available_cores()
        blocks = [
            slice(first, min(first + BLOCK_SUBCARRIERS, n_subcarriers))
            for first in range(0, n_subcarriers, BLOCK_SUBCARRIERS)
        ]
        with ThreadPoolExecutor(n_threads) as threads:
            for first in range(0, len(blocks), n_threads):
                together = blocks[first : first + n_threads]
                yield from zip(together, threads.map(one_blas_thread()(work), together), strict=True)
