"""Conduct of a call: what it must leave alone, and how long it may take, of any plugin."""

from __future__ import annotations

import io
import pickle
import random
import time
import warnings
from collections.abc import Callable
from contextlib import redirect_stdout
from typing import Any, TypeVar

import numpy as np

from isacbench.checking.contract.findings import BrokenContractError, DoubtfulError
from isacbench.plugins.registry import canonical_params

SLOW_S = 10.0
"""What is checked takes milliseconds: a run does it hundreds of times, at full size."""

TOO_SLOW_S = 60.0

SEED = 20310
HARMLESS = (DeprecationWarning, PendingDeprecationWarning, ResourceWarning, ImportWarning)

Result = TypeVar("Result")


def pickled(plugin: Any) -> Any:
    """Give what a worker process gets of a plugin.

    Raises
    ------
    BrokenContractError
        If it cannot be pickled, or comes back with other parameters.
    """
    try:
        twin = pickle.loads(pickle.dumps(plugin))
    except Exception as error:
        raise BrokenContractError(
            f"cannot be pickled ({type(error).__name__}: {error}), so that no worker process can have it: "
            "keep functions, locks and open files out of it, and its class at the top of its module"
        ) from error
    if canonical_params(twin) != canonical_params(plugin):
        raise BrokenContractError("has other parameters after pickling: leave pickling to the dataclass")
    return twin


def refuse_global_random_numbers(act: Callable[[], object]) -> None:
    """Refuse a call that draws from, or seeds, the random numbers that a process shares.

    Raises
    ------
    BrokenContractError
        If their state is not what it was.
    """
    states = random.getstate(), np.random.get_state(legacy=False)  # noqa: NPY002
    try:
        # A state of its own: a call that always seeds alike would otherwise leave its own state unchanged.
        random.seed(SEED)
        np.random.seed(SEED)  # noqa: NPY002
        before = random.getstate(), repr(np.random.get_state(legacy=False))  # noqa: NPY002
        act()
        after = random.getstate(), repr(np.random.get_state(legacy=False))  # noqa: NPY002
    finally:
        random.setstate(states[0])
        np.random.set_state(states[1])  # noqa: NPY002
    if before != after:
        raise BrokenContractError(
            "draws from the random numbers that all code of a process shares: use "
            "numpy.random.default_rng(seed) with a seed of its own"
        )


def refuse_prints(act: Callable[[], object]) -> None:
    """Refuse a call that prints.

    Raises
    ------
    BrokenContractError
        Quoting what it prints.
    """
    with redirect_stdout(io.StringIO()) as printed:
        act()
    if printed.getvalue():
        raise BrokenContractError(
            f"prints {printed.getvalue()[:40]!r} to stdout, where commands print JSON: use the module logging"
        )


def refuse_warnings(act: Callable[[], Result], hint: str = "") -> Result:
    """Refuse a call that warns, of anything but what is outdated in its own libraries.

    Parameters
    ----------
    act : callable
    hint : str
        How to mend it, said after the warning.

    Raises
    ------
    BrokenContractError
        Quoting the first warning.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = act()
    told = [warning for warning in caught if not issubclass(warning.category, HARMLESS)]
    if told:
        raise BrokenContractError(f"warns {told[0].category.__name__}: {told[0].message}{hint}")
    return result


def refuse_writes(act: Callable[[], object], what: str) -> None:
    """Refuse a call that fails because its input is read-only.

    Raises
    ------
    BrokenContractError
        If it tries to write; what else it raises goes through.
    """
    try:
        act()
    except ValueError as error:
        if "read-only" not in str(error) and "WRITEABLE" not in str(error):
            raise
        raise BrokenContractError(f"writes to {what} ({error}): copy before changing") from error


def timed_call(act: Callable[[], object], on: str) -> str:
    """Time a call.

    Raises
    ------
    BrokenContractError
        If it takes longer than a run can wait for.
    DoubtfulError
        If it takes long.
    """
    start = time.perf_counter()
    act()
    elapsed_s = time.perf_counter() - start
    took = f"{1e3 * elapsed_s:.3g} ms on {on}"
    if elapsed_s > TOO_SLOW_S:
        raise BrokenContractError(f"{took}, more than {TOO_SLOW_S:g} s: no run can be waited for")
    if elapsed_s > SLOW_S:
        raise DoubtfulError(f"{took}, more than {SLOW_S:g} s: a run does that hundreds of times")
    return took
