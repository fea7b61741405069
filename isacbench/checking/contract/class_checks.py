"""Checks of all kinds of plugins alike: the class, and the conduct of its method."""

from __future__ import annotations

import dataclasses
import inspect
import io
import pickle
import random
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isacbench.checking.contract.findings import Check, DoubtfulError
from isacbench.checking.promises.promise import BrokenPromiseError, NotApplicableError, Promise
from isacbench.errors import InputError
from isacbench.plugins.discovery import METHODS, RegisteredPlugin
from isacbench.plugins.parameters import (
    canonical_params,
    is_frozen_dataclass,
    parameter_types,
    required_fields,
)
from isacbench.plugins.registry import check_parameter
from isacbench.specifications import is_word

SLOW_S = 10.0
"""Time in s from which a check warns: a run does the same hundreds of times, at full size."""

SEED = 20310

BUILT = "default parameters"
"""Check that builds the instance of all further checks."""

CALLABLE = "arguments"
"""Check that the method takes the arguments of all further checks."""

WANTED = {"estimator": "estimate(observation)", "detector": "detect(power, looks=1)", "metric": "score(pair)"}
"""Method of a plugin with its arguments, by kind."""


class PluginSubject(ABC):
    """A plugin under check: its class, and an instance.

    Parameters
    ----------
    plugin : object, optional
        Instance to check instead of one with default parameters.
    """

    def __init__(self, entry: RegisteredPlugin, plugin: object = None) -> None:
        self.entry = entry
        self._given = plugin

    @cached_property
    def plugin_class(self) -> Any:
        """Registered class."""
        return self.entry.load()

    @property
    def module(self) -> str:
        """Module of the class, or what is registered as such where it cannot be imported."""
        loaded = vars(self).get("plugin_class")
        return str(getattr(loaded, "__module__", self.entry.module))

    @cached_property
    def plugin(self) -> Any:
        """Instance with default parameters, unless one is given."""
        return self.plugin_class() if self._given is None else self._given

    @abstractmethod
    def answer(self, plugin: Any = None, *, other: bool = False) -> list[NDArray[Any]]:
        """Call the plugin's method on small input.

        Parameters
        ----------
        plugin : object, optional
            Instance to call instead of the one under check.
        other : bool
            Whether to give it other input of the same shape.

        Returns
        -------
        list of ndarray
            What the method returns.
        """


def keeps(promise: Promise[Any], *inputs: Callable[[Any], Any]) -> Callable[[Any], str]:
    """Make a check of a promise.

    Parameters
    ----------
    *inputs : callable
        Each makes a subject of the promise from the subject of the check.

    Returns
    -------
    callable
        Takes the subject of the check; see `Check`.
    """

    def look(subject: Any) -> str:
        try:
            drift = max(promise.drift(make(subject)) for make in inputs)
        except NotApplicableError as reason:
            return str(reason)
        except BrokenPromiseError as error:
            raise BrokenPromiseError(promise.hinted(str(error))) from error
        if complaint := promise.complaint(drift):
            raise BrokenPromiseError(complaint)
        return ""

    return look


def _is_imported(subject: PluginSubject) -> str:
    plugin_class, method = subject.plugin_class, METHODS[subject.entry.kind]
    if not inspect.isclass(plugin_class):
        raise BrokenPromiseError(f"{subject.entry.target} is no class: register the class, not an instance")
    if not callable(getattr(plugin_class, method, None)):
        raise BrokenPromiseError(f"{plugin_class.__name__} has no method {method!r}: define it")
    return ""


def _is_frozen(subject: PluginSubject) -> str:
    if not is_frozen_dataclass(subject.plugin_class):
        raise BrokenPromiseError(
            f"{subject.plugin_class.__name__} is no frozen dataclass: decorate it with "
            "@dataclass(frozen=True), so that its parameters are known and stay as they are"
        )
    return ""


def _is_named(subject: PluginSubject) -> str:
    name = getattr(subject.plugin_class, "name", None)
    if name != subject.entry.name:
        raise BrokenPromiseError(
            f"it is registered as {subject.entry.name!r}, but its class attribute name is {name!r}: make "
            "them equal"
        )
    if not is_word(name):
        raise BrokenPromiseError(
            f'its name {name!r} cannot be given to commands: make it a word without any of []()=," and '
            "spaces, and no number"
        )
    if any(field.name == "name" for field in dataclasses.fields(subject.plugin_class)):
        raise BrokenPromiseError(
            "name is one of its parameters: annotate it as ClassVar[str], for it belongs to the class"
        )
    return ""


def _is_built(subject: PluginSubject) -> str:
    if missing := required_fields(subject.plugin_class):
        raise BrokenPromiseError(
            f"parameter {missing[0]} has no default: give every parameter one, for results name an "
            "estimator without parameters"
        )
    subject.plugin  # noqa: B018  built here first
    return ""


def _takes_its_arguments(subject: PluginSubject) -> str:
    method = METHODS[subject.entry.kind]
    signature = inspect.signature(getattr(subject.plugin, method))
    calls: list[tuple[list[Any], dict[str, Any]]] = [([None], {}), ([None, 1], {}), ([None], {"looks": 1})]
    if subject.entry.kind == "estimator":
        calls = [([None] * (1 + bool(getattr(subject.plugin, "needs_truth", False))), {})]
    if subject.entry.kind == "metric":
        calls = [([None], {})]
    try:
        for given, named in calls:
            signature.bind(*given, **named)
    except TypeError as error:
        raise BrokenPromiseError(
            f"{method}{signature} does not take what it is called with ({error}): define "
            f"{WANTED[subject.entry.kind].replace('(', '(self, ')}"
        ) from error
    return ""


def _is_typed(subject: PluginSubject) -> str:
    plugin = subject.plugin
    try:
        for name, hint in parameter_types(subject.entry.kind, type(plugin)).items():
            check_parameter(subject.entry.name, name, getattr(plugin, name), hint)
    except InputError as error:
        raise BrokenPromiseError(f"{error}: make the parameter's default and its type agree") from error
    return ""


def _is_canonical(subject: PluginSubject) -> str:
    try:
        canonical_params(subject.plugin)
    except InputError as error:
        raise BrokenPromiseError(str(error)) from error
    return ""


def _repeats(subject: PluginSubject) -> str:
    subject.answer()  # so that the calls before this check count for "no memory" alone
    _require_equal(
        subject.answer(),
        subject.answer(),
        "the same input gives another result the second time: draw random numbers from a generator with a "
        "fixed seed",
    )
    return ""


def _forgets(subject: PluginSubject) -> str:
    subject.answer()
    before = subject.answer()
    subject.answer(other=True)
    _require_equal(
        before,
        subject.answer(),
        "other input in between changes the result: keep nothing from one call to the next",
    )
    return ""


def _is_pickled(subject: PluginSubject) -> str:
    try:
        twin = pickle.loads(pickle.dumps(subject.plugin))
    except Exception as error:
        raise BrokenPromiseError(
            f"cannot be pickled ({type(error).__name__}: {error}), so that no worker process can have it: "
            "keep functions, locks and open files out of it, and its class at the top of its module"
        ) from error
    if canonical_params(twin) != canonical_params(subject.plugin):
        raise BrokenPromiseError("has other parameters after pickling: leave pickling to the dataclass")
    subject.answer()
    _require_equal(
        subject.answer(),
        subject.answer(twin),
        "its result differs after pickling: keep all that it needs in its parameters",
    )
    return ""


def _require_equal(first: list[NDArray[Any]], second: list[NDArray[Any]], complaint: str) -> None:
    if not all(map(np.array_equal, first, second)):
        raise BrokenPromiseError(complaint)


def _leaves_random_numbers(subject: PluginSubject) -> str:
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
        raise BrokenPromiseError(
            "draws from the random numbers that all code of a process shares: use "
            "numpy.random.default_rng(seed) with a seed of its own"
        )
    return ""


def _is_quiet(subject: PluginSubject) -> str:
    with redirect_stdout(io.StringIO()) as printed:
        subject.answer()
    if printed.getvalue():
        raise BrokenPromiseError(
            f"prints {printed.getvalue()[:40]!r} to stdout, where commands print JSON: use the module logging"
        )
    return ""


def refuse_writes(act: Callable[[], object], what: str) -> None:
    """Refuse a call that fails because its input is read-only.

    Parameters
    ----------
    what : str
        Name of the input.

    Raises
    ------
    BrokenPromiseError
        If it tries to write. Other exceptions pass.
    """
    try:
        act()
    except ValueError as error:
        if "read-only" not in str(error) and "WRITEABLE" not in str(error):
            raise
        raise BrokenPromiseError(f"writes to {what} ({error}): copy before changing") from error


def timed_call(act: Callable[[], object], on: str) -> str:
    """Time a call.

    Parameters
    ----------
    on : str
        Its input, in words.

    Returns
    -------
    str
        Time and input.

    Raises
    ------
    DoubtfulError
        If it takes longer than `SLOW_S`.
    """
    start = time.perf_counter()
    act()
    elapsed_s = time.perf_counter() - start
    took = f"{1e3 * elapsed_s:.3g} ms on {on}"
    if elapsed_s > SLOW_S:
        raise DoubtfulError(f"{took}, more than {SLOW_S:g} s: a run does that hundreds of times")
    return took


CLASS_CHECKS: tuple[Check[Any], ...] = (
    Check("import", _is_imported),
    Check("frozen dataclass", _is_frozen, ("import",)),
    Check("name", _is_named, ("frozen dataclass",)),
    Check(BUILT, _is_built, ("frozen dataclass",)),
    Check(CALLABLE, _takes_its_arguments, (BUILT,)),
    Check("parameter types", _is_typed, (BUILT,)),
    Check("canonical parameters", _is_canonical, (BUILT,)),
)


def conduct_checks(answered: str) -> tuple[Check[Any], ...]:
    """Checks of the conduct of a plugin's method.

    Parameters
    ----------
    answered : str
        Name of the check that its answers have passed before.
    """
    return (
        Check("repeatable", _repeats, (answered,)),
        Check("no memory", _forgets, ("repeatable",)),
        Check("pickling", _is_pickled, ("canonical parameters", "repeatable")),
        Check("random numbers", _leaves_random_numbers, (answered,)),
        Check("stdout", _is_quiet, (answered,)),
    )
