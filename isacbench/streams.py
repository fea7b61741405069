"""Standard streams: those of the command line, which nothing makes fail, and those that plugins are lent."""

from __future__ import annotations

import codecs
import errno
import io
import os
import select
import sys
import threading
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from typing import TYPE_CHECKING, Any, TextIO, cast

if TYPE_CHECKING:
    from collections.abc import Iterator

STREAMS = {"stdin": 0, "stdout": 1, "stderr": 2}
"""Descriptors of the standard streams."""


class _Lossy(io.FileIO):
    """File that drops what cannot be written: the reader has left, the disk is full, the terminal is gone."""

    is_lost = is_told = False

    def write(self, data: Any, /) -> int:
        left = memoryview(data).cast("B")
        while left and not self.is_lost:
            try:
                written = super().write(left)
            except OSError as error:
                self.is_lost = True
                if error.errno != errno.EPIPE and self.is_told:
                    print(f"isacbench: stdout: {error.strerror}; the rest is not printed", file=sys.stderr)
            else:
                if written is None:
                    select.select([], [self], [])  # it does not block, and is full
                left = left[written or 0 :]
        return len(data)


class OwnOutput(io.TextIOWrapper):
    """Stream of the command line, which only isacbench writes to."""

    thread: int | None = None
    """The only thread that may write, if there is one; the text of others goes to standard error."""

    def write(self, text: str, /) -> int:
        """Write text, or hand it on."""
        is_allowed = self.thread in (None, threading.get_ident())
        return super().write(text) if is_allowed else sys.stderr.write(text)


@contextmanager
def own_output() -> Iterator[None]:
    """Keep standard output to what isacbench prints in this thread; all else goes to standard error.

    Descriptor 1 leads there at once, and `sys.stdout` when the block has ended. Whatever
    becomes of the streams, printing raises no exception.
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
    own = cast("OwnOutput", sys.stdout)
    own.thread = threading.get_ident()
    os.dup2(STREAMS["stderr"], STREAMS["stdout"])
    try:
        yield
    finally:
        own.close()
        for name in ("stdout", "__stdout__"):  # for what a plugin prints when the process ends
            setattr(sys, name, sys.stderr)


class _Relay(io.RawIOBase):
    """Raw stream that hands on to a stream without a descriptor, such as that of a notebook."""

    def __init__(self, target: TextIO) -> None:
        self._target, self._decoder = target, codecs.getincrementaldecoder("utf-8")("replace")

    def readinto(self, _: Any, /) -> int:
        return 0

    def write(self, data: Any, /) -> int:
        self._target.write(self._decoder.decode(bytes(data)))
        return len(data)


class _Lent(io.RawIOBase):
    """Raw stream that a plugin is lent. It may keep it, and cannot close it.

    It leads where the standard stream of the process does at the time. What cannot be
    written is dropped.
    """

    def __init__(self, name: str) -> None:
        self.name = name

    def close(self) -> None:
        pass

    def readable(self) -> bool:
        return self.name == "stdin"

    def writable(self) -> bool:
        return self.name != "stdin"

    def fileno(self) -> int:
        return _files[self.name].fileno()

    def isatty(self) -> bool:
        return _files[self.name].isatty()

    def readinto(self, buffer: Any, /) -> int | None:
        return _files[self.name].readinto(buffer)

    def write(self, data: Any, /) -> int:
        with suppress(Exception):
            _files[self.name].write(data)
        return memoryview(data).nbytes


class _LentText(io.TextIOWrapper):
    """Standard stream that a plugin is lent."""


def _opened(name: str, stream: Any = None) -> _Lossy | _Relay:
    """Raw stream that leads where a stream does; without one, to the standard stream of the process."""
    if stream is None or isinstance(stream, io.TextIOWrapper):  # others' descriptors may lead elsewhere
        with suppress(OSError, ValueError):
            descriptor = standard = STREAMS[name]
            if not (stream is None or isinstance(stream, OwnOutput) or stream.closed):
                stream.flush()
                descriptor = stream.fileno()
            mode, is_other = "r" if name == "stdin" else "w", descriptor != standard
            return _Lossy(os.dup(descriptor) if is_other else standard, mode, closefd=is_other)
    return _Relay(stream)


_files = {name: _opened(name) for name in STREAMS}
"""Raw streams that lent ones lead to, also those that plugins have kept."""


@contextmanager
def lent_streams() -> Iterator[None]:
    """Lend the code within standard streams, which it may close, change and keep.

    On the command line, its standard output is standard error: that of isacbench may be JSON.
    """
    with ExitStack() as stack:
        for name, descriptor in STREAMS.items():
            with suppress(OSError):
                kept = os.dup(descriptor)
                stack.callback(os.close, kept)
                stack.callback(os.dup2, kept, descriptor, inheritable=True)
            stack.enter_context(_lent(name))
        yield


@contextmanager
def plugin_output() -> Iterator[None]:
    """Lend streams to the code of a plugin on the command line; elsewhere they are the caller's."""
    with lent_streams() if isinstance(sys.stdout, OwnOutput) else nullcontext():
        yield


@contextmanager
def _lent(name: str) -> Iterator[None]:
    """Lend one stream, if there is one; the raw stream stays that of a loan around this one."""
    lent = own = getattr(sys, name)
    original, before = getattr(sys, f"__{name}__"), _files[name]
    if own is not None:
        file = _files[name] = before if isinstance(own, _LentText) else _opened(name, own)
        is_text = isinstance(file, _Relay)
        encoding, errors = ("utf-8", "backslashreplace") if is_text else (own.encoding, own.errors)
        lent = _LentText(_Lent(name), encoding, errors, line_buffering=True)
    setattr(sys, name, lent)
    setattr(sys, f"__{name}__", lent)
    try:
        yield
    finally:
        with suppress(Exception):  # of what a plugin has made of it
            lent.flush()
        if _files[name] is not before:
            with suppress(OSError):
                _files[name].close()
            _files[name] = before
        setattr(sys, name, own)
        setattr(sys, f"__{name}__", original)
