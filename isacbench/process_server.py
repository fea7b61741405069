"""Where worker processes come from: a server that has imported what they need, and nothing else."""

from __future__ import annotations

import signal
from multiprocessing import get_context
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from multiprocessing.context import ForkServerContext

__all__ = ["process_context", "start_process_server"]

PRELOADED = ["isacbench.bench.guard", "isacbench.bench.studies", "isacbench.preload"]
"""What the server imports once, so that a fresh worker is there at once."""


def process_context() -> ForkServerContext:
    """Context of processes that inherit neither threads nor locks, and that start in milliseconds."""
    context = get_context("forkserver")
    context.set_forkserver_preload(PRELOADED)
    return context


def start_process_server() -> None:
    """Start the server, which imports while this process imports what it needs itself."""
    process_context()
    from multiprocessing.forkserver import ensure_running

    # Signals that end a run are for this process: the server inherits that they are blocked, and its workers
    # from it. What sends them to all processes would else leave nothing to make the report with.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
