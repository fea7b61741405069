"""Cubes written to files block by block in bounded memory: those of the caller, and simulated frames.

The noise of a simulated frame is white over the whole frame, and in the cells of the gate it is the
draw that `isacbench.observe` adds there: to each block of a white frame is
added what the canonical noise of the gate differs from the transform of that
frame. The transforms are unitary, so that this changes those cells and no
others. An image of the cube is then the image of the observation.
"""

import secrets
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from isacbench.checked_arrays import Complex, unmasked_array
from isacbench.cores import available_cores, one_blas_thread
from isacbench.cubes import tiles
from isacbench.dsp.partial_dft import doppler_rows, range_rows, transform_block
from isacbench.errors import InputError, import_extra
from isacbench.files.checked_files import known_suffix, require_new, write_errors
from isacbench.model.echo import Simulator, random_stream, resource_grid, transmitted_noise, white_gaussian
from isacbench.model.scene import Scenario

Shape: TypeAlias = tuple[int, int, int, int]
Progress: TypeAlias = Callable[[int, int], None]

CHUNK_BYTES = 2**19
CHUNK_ELEMENTS = 2
"""Elements of a chunk along either axis of the array."""

BLOCK_SUBCARRIERS = 16
"""Subcarriers of a block: 15 MB in double precision at the paper's size. The noise follows from it."""


def write_cube(
    path: str | Path,
    shape: tuple[int, ...],
    blocks: Iterable[ArrayLike],
    dtype: DTypeLike = np.complex64,
    progress: Progress | None = None,
) -> None:
    """Write a cube to a new file, block by block.

    The file is written in the same folder under a hidden name, and renamed
    when it is complete; otherwise it is removed.

    An npy file is written in C order. Zarr gets chunks of about half a
    MiB of 2 x 2 elements (64 subcarriers and all symbols at the paper's size):
    one row and one column of a 16 x 16 array are in 15 of 64 chunks, so that
    23 % of the file is read for them, where C order costs at least half of it
    and chunks of all elements cost it whole. Single elements would halve that
    again, at four times as many chunks, which a folder holds as files.
    Nothing is compressed: noise cannot be.

    Parameters
    ----------
    path : str or Path
        Suffix npy or zarr (a folder, in which the array is named ``cube``).
    shape : (int, int, int, int)
        Subcarriers N, symbols M, and elements P and Q.
    blocks : iterable of array_like of complex, shape (n, M, P, Q)
        Consecutive subcarriers, any number at a time.
    dtype : dtype
        complex64 or complex128.
    progress : callable, optional
        Called with the number of subcarriers written and of all.

    Raises
    ------
    InputError
        Before anything is written, if the suffix is another, the file exists,
        its folder does not, or the shape or type is not a cube's; later if a block
        does not fit or is masked, if subcarriers are missing, or if the disk is full.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "cube.npy"
    >>> write_cube(path, (8, 4, 2, 2), (np.ones((4, 4, 2, 2), np.complex64) for _ in range(2)))
    >>> np.load(path).shape
    (8, 4, 2, 2)
    """
    path, dtype = Path(path), np.dtype(dtype).newbyteorder("=")
    write = WRITERS[known_suffix(path, WRITERS, "a cube is written as")]
    checked_shape = tiles.require_cube(str(path), shape, dtype)
    require_new(path)
    part = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    try:
        with write_errors(path):
            write(part, checked_shape, dtype, _whole_chunks(blocks, path, checked_shape, dtype, progress))
            require_new(path)
            part.rename(path)
    finally:
        with suppress(OSError):  # a name that is too long
            shutil.rmtree(part) if part.is_dir() else part.unlink()


def chunk_lengths(shape: Shape, itemsize: int) -> Shape:
    """Lengths of a chunk: 2 x 2 elements, and along symbols and then subcarriers what makes half a MiB.

    Examples
    --------
    >>> chunk_lengths((2048, 224, 16, 16), 8)
    (64, 224, 2, 2)
    """
    n_p, n_q = (min(CHUNK_ELEMENTS, length) for length in shape[2:])
    nesting = (tiles.SUBCARRIERS, tiles.SYMBOLS, tiles.ELEMENTS)
    n_subcarriers, n_symbols, _ = tiles.box_lengths((*shape[:2], n_p * n_q), nesting, CHUNK_BYTES // itemsize)
    return n_subcarriers, n_symbols, n_p, n_q


def _whole_chunks(
    blocks: Iterable[ArrayLike], path: Path, shape: Shape, dtype: np.dtype[Any], progress: Progress | None
) -> Iterator[Complex]:
    """Blocks of whole chunks: parts of them would be read and written again and again."""
    n_chunk, n_left = chunk_lengths(shape, dtype.itemsize)[0], shape[0]
    waiting = np.empty((0, *shape[1:]), dtype)
    for block in blocks:
        given = unmasked_array(f"{path}: a block", block)
        if given.dtype.kind != "c" or given.shape[1:] != shape[1:]:
            raise InputError(
                f"{path}: a block takes complex numbers of shape "
                f"(n, {', '.join(map(str, shape[1:]))}), not {given.dtype} of shape {given.shape}"
            )
        waiting = np.concatenate([waiting, np.ascontiguousarray(given, dtype=dtype)])
        n_left -= len(given)
        if n_left < 0:
            raise InputError(f"{path}: {shape[0] - n_left} subcarriers were given; the cube has {shape[0]}")
        if n_whole := len(waiting) - (len(waiting) % n_chunk if n_left else 0):
            yield waiting[:n_whole]
            waiting = waiting[n_whole:]
            if progress is not None:
                progress(shape[0] - n_left - len(waiting), shape[0])
    if n_left:
        raise InputError(f"{path}: only {shape[0] - n_left} of {shape[0]} subcarriers were given")


def _write_npy(path: Path, shape: Shape, dtype: np.dtype[Any], blocks: Iterable[Complex]) -> None:
    header = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, header)
        for block in blocks:
            file.write(block.data)


def _write_zarr(path: Path, shape: Shape, dtype: np.dtype[Any], blocks: Iterable[Complex]) -> None:
    zarr: Any = import_extra("zarr", "cubes", "a cube in .zarr")
    array = zarr.open_group(path, mode="w").create_array(
        tiles.CUBE_NAME,
        shape=shape,
        dtype=dtype,
        chunks=chunk_lengths(shape, dtype.itemsize),
        compressors=None,
        # A chunk of zeros would otherwise look like one that was not written.
        config={"write_empty_chunks": True},
    )
    first = 0
    for block in blocks:
        array[first : first + len(block)] = block
        first += len(block)


WRITERS = {".npy": _write_npy, ".zarr": _write_zarr}


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
        self.shape = system.n_subcarriers, system.n_symbols, *scenario.array.shape
        self._along_range = range_rows(gate.range_bins, system.n_subcarriers)
        self._along_doppler = doppler_rows(gate.doppler_bins, system.n_symbols)

    def blocks(self) -> Iterator[Complex]:
        """Blocks (n, n_symbols, P, Q) of consecutive subcarriers."""
        correction, array = self._correction(), self._scenario.array
        # The places of its elements in the frame are those of the frame's elements in the array.
        in_frame = np.ravel_multi_index(tuple(array.in_frame(array.positions).T), array.shape)

        def block(subcarriers: slice) -> Complex:
            grid = resource_grid(self._scenario, array.positions, subcarriers)
            if correction is not None:
                noise = self._white_block(subcarriers)
                lines = self._along_range[:, subcarriers].conj().T @ correction.reshape(len(correction), -1)
                noise += self._along_doppler.conj().T @ lines.reshape(-1, *correction.shape[1:])
                noise *= self._noise_amplitude
                grid += noise
            if self._carried is not None:
                grid *= 1 + self._carried[subcarriers, :, None]
            return grid[:, :, in_frame].reshape(len(grid), *self.shape[1:])

        return self._each_block(block)

    def _correction(self) -> Complex | None:
        """Canonical noise of the gate less what the white frame has there; None without noise."""
        if self._wanted is None:
            return None
        n_range, n_doppler = len(self._along_range), len(self._along_doppler)
        correction = self._wanted.reshape(n_range, n_doppler, -1).copy()

        def share(subcarriers: slice) -> Complex:
            along_range = self._along_range[:, subcarriers]
            return transform_block(self._white_block(subcarriers), self._along_doppler, along_range)

        for cells in self._each_block(share):
            correction -= cells
        return correction

    def _white_block(self, subcarriers: slice) -> Complex:
        """Unit noise (n, n_symbols, e) of a block; the same whenever it is asked for."""
        stream = random_stream(self._scenario.name, self._trial, self._seed, "frame", str(subcarriers.start))
        _, n_symbols, n_p, n_q = self.shape
        return white_gaussian(stream, (subcarriers.stop - subcarriers.start, n_symbols, n_p * n_q))

    def _each_block(self, work: Callable[[slice], Complex]) -> Iterator[Complex]:
        """Work on all blocks of subcarriers, side by side and in their order, few at a time."""
        blocks, n_threads = tiles.slices(self.shape[0], BLOCK_SUBCARRIERS), available_cores()
        for _, block in tiles.in_order(one_blas_thread()(work), blocks, n_threads, n_threads):
            yield block
