"""The plan of a run: its cells in the order of the table, and the blocks in which they are worked off.

A cell's position follows from its key alone, so that rows that come from a
file, from another process or in another order find their place.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby, pairwise
from threading import Lock
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from isacbench.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from isacbench.bench.kinds.scenes import Entry, Scene


class Block(NamedTuple):
    """Cells that share an observation.

    Attributes
    ----------
    scene : int
        Index of the scene.
    entries : tuple of int
        Indices into the scene's entries, those that have not met it yet.
    """

    scene: int
    trial: int
    snr_db: float
    entries: tuple[int, ...]


class Shard(NamedTuple):
    """Part `k` of `n` of a run, counted from 1."""

    k: int
    n: int

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Parse ``k/n``.

        Raises
        ------
        InputError
            Quoting the text and saying what is allowed.

        Examples
        --------
        >>> Shard.parse("2/3")
        Shard(k=2, n=3)
        """
        k, _, n = text.partition("/")
        if not (text.isascii() and k.isdecimal() and n.isdecimal() and 1 <= int(k) <= int(n)):
            raise InputError(f"shard {text!r}: allowed is k/n with 1 <= k <= n, such as 2/3")
        return cls(int(k), int(n))


@dataclass(frozen=True, eq=False)
class Plan:
    """Every cell of a run: scene by scene, trial by trial, SNR by SNR, entry by entry."""

    scenes: Sequence[Scene]
    n_trials: int

    @property
    def n_cells(self) -> int:
        """Cells of all scenes."""
        return int(self._offsets[-1])

    @property
    def entries(self) -> list[Entry[Any]]:
        """Entries of all scenes, once each."""
        every = {(one.name, one.params): one for scene in self.scenes for one in scene.entries}
        return list(every.values())

    def positions(self, keys: pd.DataFrame) -> NDArray[np.int64]:
        """Positions in the table of some cells.

        Parameters
        ----------
        keys : DataFrame
            With the columns scenario, estimator, params, snr_db and trial.

        Returns
        -------
        ndarray of int64, shape (n,)
            -1 where the plan has no such cell.
        """
        found = np.full(len(keys), -1, dtype=np.int64)
        names = pd.Index([scene.name for scene in self.scenes])
        of_scene = names.get_indexer(pd.Index(keys["scenario"]))
        for index in np.unique(of_scene[of_scene >= 0]):
            (chosen,) = np.nonzero(of_scene == index)
            found[chosen] = self._positions_in(int(index), keys.iloc[chosen])
        return found

    def blocks(self, todo: NDArray[np.bool_]) -> list[Block]:
        """List the blocks of the cells that are marked.

        Parameters
        ----------
        todo : ndarray of bool, shape (n_cells,)

        Returns
        -------
        list of Block
            In the order of the table.
        """
        blocks = []
        for index, scene in enumerate(self.scenes):
            shape = self.n_trials, len(scene.snr_db), len(scene.entries)
            marked = todo[self._offsets[index] : self._offsets[index + 1]].reshape(shape)
            for trial, at_snr in zip(*np.nonzero(marked.any(axis=2)), strict=True):
                entries = tuple(np.flatnonzero(marked[trial, at_snr]).tolist())
                blocks.append(Block(index, int(trial), scene.snr_db[at_snr], entries))
        return blocks

    def shard(self, shard: Shard) -> NDArray[np.bool_]:
        """Mark the cells of a part of the run: whole trials of a scene, if there are enough.

        Returns
        -------
        ndarray of bool, shape (n_cells,)
        """
        blocks = self.blocks(np.ones(self.n_cells, dtype=np.bool_))
        trials = [block[:2] for block in blocks]
        part = np.cumsum([before != after for before, after in pairwise([trials[0], *trials])])
        if part[-1] + 1 < shard.n:
            part = np.arange(len(blocks))
        return np.repeat(part % shard.n == shard.k - 1, [len(block.entries) for block in blocks])

    @cached_property
    def _offsets(self) -> NDArray[np.int64]:
        """Position of the first cell of every scene, and of the end."""
        sizes = [self.n_trials * len(scene.snr_db) * len(scene.entries) for scene in self.scenes]
        return np.concatenate([[0], np.cumsum(sizes, dtype=np.int64)])

    def _positions_in(self, index: int, keys: pd.DataFrame) -> NDArray[np.int64]:
        scene = self.scenes[index]
        at_snr = pd.Index(scene.snr_db, dtype=np.float64).get_indexer(pd.Index(keys["snr_db"]))
        variants = pd.MultiIndex.from_tuples([(one.name, one.params) for one in scene.entries])
        entry = variants.get_indexer(pd.MultiIndex.from_frame(keys[["estimator", "params"]]))
        trial = keys["trial"].to_numpy()
        known = (at_snr >= 0) & (entry >= 0) & (trial >= 0) & (trial < self.n_trials)
        inside = (trial * len(scene.snr_db) + at_snr) * len(scene.entries) + entry
        return np.where(known, self._offsets[index] + inside, -1)


class BlockQueue:
    """Blocks for several workers: each goes on with its own trial of a scene, whose echo it keeps."""

    def __init__(self, blocks: Sequence[Block]) -> None:
        self._lock = Lock()
        self._waiting = deque(deque(group) for _, group in groupby(blocks, key=lambda block: block[:2]))
        self._taken: list[deque[Block]] = []

    def blocks(self) -> Iterator[Block]:
        """Blocks for one worker, until no block is left."""
        mine: deque[Block] = deque()
        while (block := self._next(mine)) is not None:
            yield block

    def _next(self, mine: deque[Block]) -> Block | None:
        with self._lock:
            if not mine and self._waiting:
                mine.extend(self._waiting.popleft())
                if not any(mine is other for other in self._taken):
                    self._taken.append(mine)
            if mine:
                return mine.popleft()
            # No trial is untouched: take the last block of the longest queue.
            fullest = max(self._taken, key=len, default=mine)
            return fullest.pop() if fullest else None
