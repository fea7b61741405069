"""A plugin file that goes wrong in every way that came to mind; tests read it as text."""

import collections
import ctypes
import itertools
import os
import random
import resource
import signal
import sys
import threading
import time
import warnings
from dataclasses import dataclass
from multiprocessing import connection
from pathlib import Path
from typing import ClassVar

import numpy as np

from isacbench.model.cloud import PointCloud

NAPPING = threading.Event()
"""Set in a process in which somebody takes a nap."""


def points(observation, n=1):
    """Image that hangs on every value of the observation."""
    region = observation.region
    share = float(np.abs(observation.cells).sum() % 1)
    xyz = region.lower_m + (region.upper_m - region.lower_m) * share
    speed = observation.gate.doppler_bins[0] * observation.system.velocity_bin_mps
    return PointCloud(np.tile(xyz, (n, 1)), np.full(n, speed + observation.base_station_m[0]), np.ones(n))


@dataclass(frozen=True)
class Good:
    """Does what it should."""

    name: ClassVar[str] = "good"
    n: int = 1

    def estimate(self, observation):
        return points(observation, self.n)


@dataclass(frozen=True)
class Dice:
    """Uses the random generators that everybody shares."""

    name: ClassVar[str] = "dice"
    n: int = 1

    def estimate(self, observation):
        xyz = [[random.random(), np.random.rand(), 1.0]]  # noqa: NPY002
        return PointCloud(xyz, [0.0], [1.0])


class OwnError(Exception):
    """Cannot be unpickled."""

    def __init__(self, a, b):
        super().__init__("own")


class MuteError(Exception):
    """Cannot be told."""

    def __str__(self):
        raise ValueError("no words")


class Base(BaseException):
    """No Exception."""


def smuggled(**changes):
    """Cloud whose constructor has not seen what it holds."""
    cloud = object.__new__(PointCloud)
    fields = {"xyz": np.zeros((2, 3)), "velocity": np.zeros(2), "power": np.ones(2), **changes}
    for name, value in fields.items():
        object.__setattr__(cloud, name, value)
    return cloud


def grow(piece):
    """Take all memory there is."""
    held = []
    while True:
        held.append(np.ones(piece))


def write_by_address(array):
    """Write into a read-only array."""
    ctypes.memset(array.ctypes.data, 0, 64)


def unlock(array):
    """Write into an array that owns its memory."""
    owner = array if array.base is None else array.base
    owner.setflags(write=True)
    owner.reshape(-1)[:4] = 0


def stay(path):
    """Leave a child behind, and tell its number."""
    child = os.fork()
    if child == 0:
        time.sleep(600)
        os._exit(0)
    if path:
        with Path(path).open("a") as file:
            file.write(f"{child}\n")


def send_half(self, content):
    """Die in the middle of an answer."""
    os.write(self.fileno(), bytes(content)[: len(content) // 2])
    os._exit(5)


def disturb():
    """Change what is put back after each cell."""
    os.chdir("/")
    os.environ.clear()
    np.seterr(all="raise")
    warnings.simplefilter("error")
    sys.stdout = None
    np.set_printoptions(precision=1, threshold=3)
    random.seed(0)
    np.random.seed(0)  # noqa: NPY002


@dataclass(frozen=True)
class Wreck:
    """Goes wrong in a chosen way."""

    name: ClassVar[str] = "wreck"
    kind: str = "raise"
    path: str = ""

    def estimate(self, observation):
        return getattr(self, self.kind)(observation)

    def raise_(self, observation):
        raise ZeroDivisionError("no luck")

    def own(self, observation):
        raise OwnError(1, 2)

    def mute(self, observation):
        raise MuteError

    def base(self, observation):
        raise Base("no Exception")

    def surrogate(self, observation):
        raise OSError("caf\udce9\0\n\ttwo lines")

    def long(self, observation):
        raise ValueError("x" * 10_000_000)

    def recursion(self, observation):
        return self.recursion(observation)

    def interrupt(self, observation):
        raise KeyboardInterrupt

    def interrupt_and_change(self, observation):
        unlock(observation.cells)
        raise KeyboardInterrupt

    def leave(self, observation):
        sys.exit(7)

    def exit0(self, observation):
        os._exit(0)

    def exit7(self, observation):
        os._exit(7)

    def kill(self, observation):
        os.kill(os.getpid(), signal.SIGKILL)

    def segfault(self, observation):
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        ctypes.string_at(0)

    def not_finite(self, observation):
        return PointCloud([[0, 0, np.nan]], [0], [1])

    def smuggle_nan(self, observation):
        return smuggled(xyz=np.full((2, 3), np.nan))

    def smuggle_shape(self, observation):
        return smuggled(velocity=np.zeros(3))

    def replace_nan(self, observation):
        cloud = points(observation)
        object.__setattr__(cloud, "power", np.array([np.nan]))
        return cloud

    def number(self, observation):
        return 3

    def nothing(self, observation):
        return None

    def hog_small(self, observation):
        grow(1000)

    def hog_large(self, observation):
        grow(10**10)

    def close_all(self, observation):
        os.closerange(0, 1000)
        return points(observation)

    def half(self, observation):
        connection.Connection._send = send_half
        return points(observation)

    def loop(self, observation):
        while True:
            pass

    def loop_in_c(self, observation):
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        collections.deque(itertools.repeat(None), maxlen=0)

    def freeze(self, observation):
        os.kill(os.getpid(), signal.SIGSTOP)

    def unlock(self, observation):
        unlock(observation.cells)
        return points(observation)

    def by_address(self, observation):
        write_by_address(observation.cells)
        return points(observation)

    def move_station(self, observation):
        unlock(observation.base_station_m)
        return points(observation)

    def swap_cells(self, observation):
        object.__setattr__(observation, "cells", None)
        return PointCloud.empty()

    def mirror(self, observation):
        observation.cells.setflags(write=True)
        observation.cells[:] = observation.cells[::-1].copy()
        return points(observation)

    # Strange, but no failure.

    def child(self, observation):
        stay(self.path)
        return points(observation)

    def child_and_die(self, observation):
        stay(self.path)
        os._exit(9)

    def twins(self, observation):
        os.fork()
        return points(observation)

    def disturb(self, observation):
        cloud = points(observation)
        disturb()
        return cloud

    def thread(self, observation):
        threading.Thread(target=threading.Event().wait, daemon=False).start()
        return points(observation)

    def flood(self, observation):
        print("x" * 3_000_000)
        return points(observation)

    def later(self, observation):
        threading.Thread(target=lambda: NAPPING.wait() and os._exit(7), daemon=True).start()
        return points(observation)

    def nap(self, observation):
        NAPPING.set()
        time.sleep(1)
        return points(observation)

    def ask(self, observation):
        input()
