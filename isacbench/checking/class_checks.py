"""Checks of all kinds of plugins alike: the class, and the conduct of its method."""

from __future__ import annotations

import dataclasses
import inspect
import io
import pickle
import random
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isacbench.checking.checks import Check, CheckFailedError, DoubtfulError
from isacbench.errors import InputError
from isacbench.plugins.discovery import METHODS, RegisteredPlugin
from isacbench.plugins.registry import (
    canonical_params,
    check_parameter,
    is_frozen_dataclass,
    parameter_types,
    required_fields,
)
from isacbench.specifications import is_word

SLOW_S = 10.0
"""Time in s from which a check warns: a run does the same hundreds of times, at full size."""

SEED = 20310

BUILT = "default parameters"
"""Check that builds the instance of all further checks."""

CALLABLE = "arguments"
"""Check that the method takes the arguments of all further checks."""

ARGUMENTS = {"estimator": "observation", "detector": "power, looks=1", "metric": "pair"}
"""Of the method of a plugin, by kind."""


class PluginSubject(ABC):
    """A plugin under check: its class, and an instance, with default parameters unless one is given."""

    def __init__(self, entry: RegisteredPlugin, plugin: object = None) -> None:
        self.entry = entry
        self._given = plugin

    @cached_property
    def plugin_class(self) -> Any:
        """Registered class."""
        return self.entry.load()

    @property
    def plugin_module(self) -> str:
        """Module of the class, or what is registered as such where it cannot be imported."""
        loaded = vars(self).get("plugin_class")
        return str(getattr(loaded, "__module__", self.entry.module))

    @cached_property
    def plugin(self) -> Any:
        """Instance under check."""
        return self.plugin_class() if self._given is None else self._given

    @abstractmethod
    def answer(self, plugin: Any = None, *, other: bool = False) -> list[NDArray[Any]]:
        """Results of the plugin, or of another instance, on one of two small inputs of the same shape."""


def sees_truth(plugin: object) -> bool:
    """Tell whether an estimator, or its class, returns what it makes of the truth."""
    return bool(getattr(plugin, "needs_truth", False))


@contextmanager
def input_errors_fail(hint: str = "") -> Iterator[None]:
    """Fail the check with the message of an `InputError` within, without the place where it was raised."""
    try:
        yield
    except InputError as error:
        raise CheckFailedError(f"{error}{hint}") from error


def _is_imported(subject: PluginSubject) -> None:
    plugin_class, method = subject.plugin_class, METHODS[subject.entry.kind]
    if not inspect.isclass(plugin_class):
        raise CheckFailedError(f"{subject.entry.target} is no class: register the class, not an instance")
    if not callable(getattr(plugin_class, method, None)):
        raise CheckFailedError(f"{plugin_class.__name__} has no method {method!r}: define it")


def _is_frozen(subject: PluginSubject) -> None:
    if not is_frozen_dataclass(subject.plugin_class):
        raise CheckFailedError(
            f"{subject.plugin_class.__name__} is no frozen dataclass: decorate it with "
            "@dataclass(frozen=True), so that its parameters are known and stay as they are"
        )


def _is_named(subject: PluginSubject) -> None:
    name = getattr(subject.plugin_class, "name", None)
    if name != subject.entry.name:
        raise CheckFailedError(
            f"it is registered as {subject.entry.name!r}, but its class attribute name is {name!r}: make "
            "them equal"
        )
    if not is_word(name):
        raise CheckFailedError(
            f'its name {name!r} cannot be given to commands: make it a word without any of []()=," and '
            "spaces, and no number"
        )
    if any(field.name == "name" for field in dataclasses.fields(subject.plugin_class)):
        raise CheckFailedError(
            "name is one of its parameters: annotate it as ClassVar[str], for it belongs to the class"
        )


def _is_built(subject: PluginSubject) -> None:
    if missing := required_fields(subject.plugin_class):
        raise CheckFailedError(
            f"parameter {missing[0]} has no default: give every parameter one, for results name an "
            "estimator without parameters"
        )
    subject.plugin  # noqa: B018  built here first


def _takes_its_arguments(subject: PluginSubject) -> None:
    kind, method = subject.entry.kind, METHODS[subject.entry.kind]
    signature = inspect.signature(getattr(subject.plugin, method))
    try:
        signature.bind(*[None] * (2 if kind == "estimator" and sees_truth(subject.plugin) else 1))
        if kind == "detector":
            signature.bind(None, 1)
            signature.bind(None, looks=1)
    except TypeError as error:
        raise CheckFailedError(
            f"{method}{signature} does not take what it is called with ({error}): define "
            f"{method}(self, {ARGUMENTS[kind]})"
        ) from error


def _is_typed(subject: PluginSubject) -> None:
    plugin = subject.plugin
    with input_errors_fail(": make the parameter's default and its type agree"):
        for name, hint in parameter_types(subject.entry.kind, type(plugin)).items():
            check_parameter(subject.entry.name, name, getattr(plugin, name), hint)


def _is_canonical(subject: PluginSubject) -> None:
    with input_errors_fail():
        canonical_params(subject.plugin)


def _repeats(subject: PluginSubject) -> None:
    subject.answer()  # so that the calls before this check count for "no memory" alone
    if not _are_equal(subject.answer(), subject.answer()):
        raise CheckFailedError(
            "the same input gives another result the second time: draw random numbers from a generator with "
            "a fixed seed"
        )


def _forgets(subject: PluginSubject) -> None:
    subject.answer()
    before = subject.answer()
    subject.answer(other=True)
    if not _are_equal(before, subject.answer()):
        raise CheckFailedError(
            "other input in between changes the result: keep nothing from one call to the next"
        )


def _is_pickled(subject: PluginSubject) -> None:
    try:
        twin = pickle.loads(pickle.dumps(subject.plugin))
    except Exception as error:
        raise CheckFailedError(
            f"cannot be pickled ({type(error).__name__}: {error}), so that no worker process can have it: "
            "keep functions, locks and open files out of it, and its class at the top of its module"
        ) from error
    if canonical_params(twin) != canonical_params(subject.plugin):
        raise CheckFailedError("has other parameters after pickling: leave pickling to the dataclass")
    subject.answer()
    if not _are_equal(subject.answer(), subject.answer(twin)):
        raise CheckFailedError("its result differs after pickling: keep all that it needs in its parameters")


def _are_equal(first: list[NDArray[Any]], second: list[NDArray[Any]]) -> bool:
    return all(map(np.array_equal, first, second))


def _leaves_random_numbers(subject: PluginSubject) -> None:
    states = random.getstate(), np.random.get_state(legacy=False)  # noqa: NPY002
    try:
        # A known state: a plugin that always seeds alike would leave the state of its last call unchanged.
        random.seed(SEED)
        np.random.seed(SEED)  # noqa: NPY002
        before = random.getstate(), repr(np.random.get_state(legacy=False))  # noqa: NPY002
        subject.answer()
        after = random.getstate(), repr(np.random.get_state(legacy=False))  # noqa: NPY002
    finally:
        random.setstate(states[0])
        np.random.set_state(states[1])  # noqa: NPY002
    if before != after:
        raise CheckFailedError(
            "draws from the random numbers that all code of a process shares: use "
            "numpy.random.default_rng(seed) with a seed of its own"
        )


def _is_quiet(subject: PluginSubject) -> None:
    with redirect_stdout(io.StringIO()) as printed:
        subject.answer()
    if printed.getvalue():
        raise CheckFailedError(
            f"prints {printed.getvalue()[:40]!r} to stdout, where commands print JSON: use the module logging"
        )


def refuse_writes(act: Callable[[], object], what: str) -> None:
    """Fail a call that writes to its read-only input, which is called `what`. Other exceptions pass."""
    try:
        act()
    except ValueError as error:
        if "read-only" not in str(error) and "WRITEABLE" not in str(error):
            raise
        raise CheckFailedError(f"writes to {what} ({error}): copy before changing") from error


def timed_call(act: Callable[[], object], on: str) -> str:
    """Say how long a call takes on an input, and doubt one that takes longer than `SLOW_S`."""
    start = time.perf_counter()
    act()
    elapsed_s = time.perf_counter() - start
    took = f"{1e3 * elapsed_s:.3g} ms on {on}"
    if elapsed_s > SLOW_S:
        raise DoubtfulError(f"{took}, more than {SLOW_S:g} s: a run does that hundreds of times")
    return took


CLASS_CHECKS = (
    Check("import", _is_imported),
    Check("frozen dataclass", _is_frozen, needs=("import",)),
    Check("name", _is_named, needs=("frozen dataclass",)),
    Check(BUILT, _is_built, needs=("frozen dataclass",)),
    Check(CALLABLE, _takes_its_arguments, needs=(BUILT,)),
    Check("parameter types", _is_typed, needs=(BUILT,)),
    Check("canonical parameters", _is_canonical, needs=(BUILT,)),
)


def conduct_checks(answered: str) -> tuple[Check, ...]:
    """Checks of the conduct of a plugin's method, whose answers have passed the check of that name."""
    return (
        Check("repeatable", _repeats, needs=(answered,)),
        Check("no memory", _forgets, needs=("repeatable",)),
        Check("pickling", _is_pickled, needs=("canonical parameters", "repeatable")),
        Check("random numbers", _leaves_random_numbers, needs=(answered,)),
        Check("stdout", _is_quiet, needs=(answered,)),
    )
