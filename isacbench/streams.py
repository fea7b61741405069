"""Standard streams: those of the command line, which nothing makes fail, and those that plugins are lent."""

from __future__ import annotations

import codecs
import errno
import io
import os
import select
import sys
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from typing import TYPE_CHECKING, Any, TextIO

if TYPE_CHECKING:
    from collections.abc import Iterator

STREAMS = {"stdin": 0, "stdout": 1, "stderr": 2}
"""Descriptors of the standard streams."""


class _Lossy(io.FileIO):
    """File that drops what cannot be written: the reader has left, the disk is full, the terminal is gone."""

    is_lost = is_told = False

    def write(self, data: Any, /) -> int:
        while not self.is_lost:
            try:
                written = super().write(data)
            except OSError as error:
                self.is_lost = True
                if error.errno != errno.EPIPE and self.is_told:
                    print(f"isacbench: stdout: {error.strerror}; the rest is not printed", file=sys.stderr)
            else:
                if written is not None:
                    return written
                select.select([], [self], [])  # it does not block, and is full
        return len(data)


class OwnOutput(io.TextIOWrapper):
    """Standard output of the command line, which only isacbench writes to."""


@contextmanager
def own_output() -> Iterator[None]:
    """Keep standard output to what isacbench prints; descriptor 1 leads to standard error for all else.

    Whatever becomes of the streams, printing raises no exception.
    """
    for descriptor in STREAMS.values():
        with suppress(OSError):
            os.fstat(descriptor)
            continue
        os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free
    for name in ("stdout", "stderr"):
        before, descriptor = getattr(sys, name), STREAMS[name]
        raw = _Lossy(os.dup(descriptor), "w")
        raw.is_told = name == "stdout"
        stream = OwnOutput(
            io.BufferedWriter(raw),
            encoding=getattr(before, "encoding", "utf-8"),
            errors=getattr(before, "errors", "strict").replace("strict", "backslashreplace"),
            line_buffering=name == "stderr" or raw.isatty(),
        )
        setattr(sys, name, stream)
        setattr(sys, f"__{name}__", stream)  # which the width of the terminal is asked of
    os.dup2(STREAMS["stderr"], STREAMS["stdout"])
    try:
        yield
    finally:
        sys.stdout.flush()


class _Relay(io.RawIOBase):
    """Raw stream that hands on to a stream without a descriptor, such as that of a notebook."""

    def __init__(self, target: TextIO) -> None:
        self._target, self._decoder = target, codecs.getincrementaldecoder("utf-8")("replace")

    def writable(self) -> bool:
        return True

    def write(self, data: Any, /) -> int:
        self._target.write(self._decoder.decode(bytes(data)))
        return len(data)


@contextmanager
def lent_streams() -> Iterator[None]:
    """Lend duplicates of the standard streams to the code within, which may close them.

    On the command line, its standard output is standard error: that of isacbench may be JSON.
    """
    with ExitStack() as stack:
        for name, descriptor in STREAMS.items():
            own = getattr(sys, name), getattr(sys, f"__{name}__")
            with suppress(OSError):
                kept = os.dup(descriptor)
                stack.callback(os.close, kept)
                stack.callback(os.dup2, kept, descriptor, inheritable=True)
            lent = _duplicate(name, own[0])
            setattr(sys, name, lent)
            setattr(sys, f"__{name}__", lent)
            stack.callback(_take_back, name, lent, *own)
        yield


@contextmanager
def plugin_output() -> Iterator[None]:
    """Lend streams to the code of a plugin on the command line; elsewhere they are the caller's."""
    with lent_streams() if isinstance(sys.stdout, OwnOutput) else nullcontext():
        yield


def _duplicate(name: str, stream: Any) -> Any:
    """Stream of its own that leads where a standard stream does."""
    if stream is None:
        return None
    mode = "r" if name == "stdin" else "w"
    target = sys.stderr if isinstance(stream, OwnOutput) else stream
    if isinstance(target, io.TextIOWrapper):  # others, as in notebooks, have descriptors that lead elsewhere
        with suppress(OSError, ValueError):
            if target.closed:  # of which the descriptor is left, where it is one of a standard stream
                return os.fdopen(os.dup(STREAMS[name]), mode, errors="backslashreplace")
            if mode == "w":
                target.flush()
            descriptor = os.dup(target.fileno())
            return os.fdopen(descriptor, mode, buffering=1, encoding=target.encoding, errors=target.errors)
    if mode == "r":
        return io.StringIO()
    return io.TextIOWrapper(_Relay(target), encoding="utf-8", write_through=True)


def _take_back(name: str, lent: Any, own: Any, original: Any) -> None:
    with suppress(Exception):  # of what a plugin has made of it
        lent.close()
    setattr(sys, name, own)
    setattr(sys, f"__{name}__", original)
