"""Checks of plugins: what one is, what it finds, and those of all kinds of plugins alike; and cases to check.

A finding says in words what is wrong and how to mend it. All kinds of plugins are checked for their class and
for the conduct of their method.

A case is hostile but finite input, written ``name[param=value,...]``, with the checks that are made on it. A
family of cases is a function with a space for each parameter. Its table lists the cases that are always gone
through; the random search draws from the same spaces, and what it finds is added to the table.
"""

from __future__ import annotations

import dataclasses
import inspect
import io
import math
import pickle
import random
import time
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, redirect_stdout
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from isacbench.errors import InputError, unknown_name
from isacbench.files.escaping import escape_control
from isacbench.plugins import registry
from isacbench.plugins.discovery import METHODS, RegisteredPlugin, error_place
from isacbench.process_state import process_state_kept

HARMLESS = (DeprecationWarning, PendingDeprecationWarning, ResourceWarning, ImportWarning)
"""Warnings about outdated libraries: no plugin fails because of them."""

Status = Literal["ok", "warning", "failed", "skipped", "refused", "timeout", "killed"]
"""Refused: an `InputError` where that is a proper answer; timeout, killed: the process was lost."""

SLOW_S = 10.0
"""Time in s from which a check warns: a run does the same hundreds of times, at full size."""

SEED = 20310

ODD = 1.7
"""Scale factor that is not a power of two, so that products round."""

BUILT = "default parameters"
"""Check that builds the instance of all further checks."""

CALLABLE = "arguments"
"""Check that the method takes the arguments of all further checks."""

ARGUMENTS = {"estimator": "observation", "detector": "power, looks=1", "metric": "pair"}
"""Of the method of a plugin, by kind."""


class CheckFailedError(Exception):
    """A plugin does not do what a check asks of it; the message says how, and how to mend it."""


def require(condition: object, failure: str) -> None:
    """Fail the check with these words unless the condition holds."""
    if not condition:
        raise CheckFailedError(failure)


class DoubtfulError(Exception):
    """The plugin keeps the contract, but probably not its author's intention; the message says why."""


class NotApplicableError(Exception):
    """A check says nothing about this plugin or this input; the message says why."""


@dataclass(frozen=True, eq=False)
class Subject:
    """A plugin together with its input.

    Attributes
    ----------
    may_refuse : bool
        An `InputError` is a proper answer to this input.
    """

    plugin: Any
    may_refuse: bool = field(default=False, kw_only=True)

    @property
    def plugin_module(self) -> str:
        """Module of the plugin's class."""
        return type(self.plugin).__module__


@dataclass(frozen=True)
class Check:
    """Check of a plugin.

    Attributes
    ----------
    measure : callable
        Takes the subject; returns its difference from what is promised, a
        measurement in words, or nothing. Raises one of the errors of this
        module; any other exception is the plugin's, and fails the check.
    bound : float
        Largest difference that is allowed.
    hint : str
        How to mend it.
    needs : tuple of str
        Names of checks that must have passed before; see `run_checks`.
    """

    name: str
    measure: Callable[[Any], float | str | None]
    bound: float = 0.0
    hint: str = ""
    needs: tuple[str, ...] = ()

    def of(self, subjects: Callable[[Any], Iterable[Any]], *needs: str, name: str = "") -> Check:
        """Make the same check of all the subjects that follow from another one."""

        def measure(subject: Any) -> float:
            return max(float(self.measure(one) or 0.0) for one in subjects(subject))

        return Check(name or self.name, measure, self.bound, self.hint, needs)


@dataclass(frozen=True)
class Finding:
    """Finding of a check.

    Attributes
    ----------
    check : str
        Name of the check.
    status : {"ok", "warning", "failed", "skipped", "refused", "timeout", "killed"}
        Skipped where a check that it needs has failed, or where it says nothing about the plugin.
    message : str
        What is wrong and how to mend it; a measurement, or nothing, where the
        check has passed.
    difference, bound : float
        Measured difference, 0 where there is nothing to measure, and the largest
        allowed; NaN where the check says something in words or did not come so far.
    """

    check: str
    status: Status
    message: str = ""
    difference: float = math.nan
    bound: float = math.nan
    time_s: float = field(default=math.nan, compare=False)


def run_check(check: Check, subject: Subject | PluginSubject, *, is_strict: bool = False) -> Finding:
    """Run a check to a finding, whatever the plugin does.

    Strict, on hostile input, a warning fails the check, a check that says nothing is skipped instead of
    passed, and an `InputError` is an answer, if a wrong one unless the subject says that it may refuse.
    """
    start = time.perf_counter()
    caught = (Exception, SystemExit, KeyboardInterrupt) if is_strict else (Exception, SystemExit)
    status: Status = "failed"
    difference = bound = math.nan
    message = ""
    try:
        with warnings_fail() if is_strict else nullcontext():
            measured = check.measure(subject)
        if isinstance(measured, str):
            message = measured
        else:
            difference, bound = measured or 0.0, check.bound
            require(difference <= bound, f"off by {difference:.2g}, at most {bound:.2g} is allowed")
        status = "ok"
    except CheckFailedError as error:
        message = f"{error}: {check.hint}" if check.hint else str(error)
    except DoubtfulError as error:
        status, message = "warning", str(error)
    except NotApplicableError as reason:
        status, message = "skipped" if is_strict else "ok", str(reason)
    except caught as error:  # of the plugin
        if isinstance(error, InputError) and is_strict:
            status, message = "refused" if subject.may_refuse else "failed", str(error)
        else:
            place = error_place(error, subject.plugin_module)
            message = f"raises {type(error).__name__}: {error}" + (f" ({place})" if place else "")
    message = escape_control(message) if is_strict else message
    return Finding(check.name, status, message, difference, bound, time.perf_counter() - start)


def run_checks(checks: Sequence[Check], subject: PluginSubject) -> Iterator[Finding]:
    """Run checks in their order, without a word of the plugin on the terminal.

    A check is skipped where one that it needs has failed.
    """
    found: dict[str, Finding] = {}
    for check in checks:
        missing = [name for name in check.needs if found[name].status in ("failed", "skipped")]
        if missing:
            found[check.name] = Finding(check.name, "skipped", f"needs {missing[0]!r}")
        else:
            with redirect_stdout(io.StringIO()), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                found[check.name] = run_check(check, subject)
        yield found[check.name]


@contextmanager
def warnings_fail(hint: str = "") -> Iterator[None]:
    """Fail the check with the first warning within, `HARMLESS` ones excepted."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    for warning in caught:
        is_harmless = issubclass(warning.category, HARMLESS)
        require(is_harmless, f"warns {warning.category.__name__}: {warning.message}{hint}")


# Checks of all kinds of plugins alike.


class PluginSubject(ABC):
    """A plugin under check: its class, and an instance, with default parameters unless one is given."""

    may_refuse = False

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

    @abstractmethod
    def prepare_call(self, *, writable: bool) -> tuple[Callable[[], object], str]:
        """Prepare a call of the plugin on arrays that are writable or not, and say what they are."""


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


def require_no_mistake(check: str, subject: PluginSubject) -> None:
    """Fail with the mistake of the class that the check of that name is for, if there is one."""
    for found, mistake in registry.class_mistakes(subject.entry, subject.plugin_class):
        require(found != check, mistake)


def _is_named(subject: PluginSubject) -> None:
    require_no_mistake("name", subject)
    require(
        all(field.name != "name" for field in dataclasses.fields(subject.plugin_class)),
        "name is one of its parameters: annotate it as ClassVar[str], for it belongs to the class",
    )


def _is_built(subject: PluginSubject) -> None:
    missing = ", ".join(registry.required_fields(subject.plugin_class))
    require(
        not missing,
        f"parameter {missing} has no default: give every parameter one, for results name an estimator "
        "without parameters",
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
        for name, hint in registry.parameter_types(subject.entry.kind, type(plugin)).items():
            registry.check_parameter(subject.entry.name, name, getattr(plugin, name), hint)


def _is_canonical(subject: PluginSubject) -> None:
    with input_errors_fail():
        registry.canonical_params(subject.plugin)


def _repeats(subject: PluginSubject) -> None:
    subject.answer()  # so that the calls before this check count for "no memory" alone
    require(
        _are_equal(subject.answer(), subject.answer()),
        "the same input gives another result the second time: draw random numbers from a generator with a "
        "fixed seed",
    )


def _forgets(subject: PluginSubject) -> None:
    subject.answer()
    before = subject.answer()
    subject.answer(other=True)
    require(
        _are_equal(before, subject.answer()),
        "other input in between changes the result: keep nothing from one call to the next",
    )


def _is_pickled(subject: PluginSubject) -> None:
    try:
        twin = pickle.loads(pickle.dumps(subject.plugin))
    except Exception as error:
        raise CheckFailedError(
            f"cannot be pickled ({type(error).__name__}: {error}), so that no worker process can have it: "
            "keep functions, locks and open files out of it, and its class at the top of its module"
        ) from error
    is_same = registry.canonical_params(twin) == registry.canonical_params(subject.plugin)
    require(is_same, "has other parameters after pickling: leave pickling to the dataclass")
    subject.answer()
    require(
        _are_equal(subject.answer(), subject.answer(twin)),
        "its result differs after pickling: keep all that it needs in its parameters",
    )


def _are_equal(first: list[NDArray[Any]], second: list[NDArray[Any]]) -> bool:
    return all(map(np.array_equal, first, second))


def _leaves_random_numbers(subject: PluginSubject) -> None:
    with process_state_kept():
        # A known state: a plugin that always seeds alike would leave the state of its last call unchanged.
        random.seed(SEED)
        np.random.seed(SEED)  # noqa: NPY002
        before = _random_states()
        subject.answer()
        after = _random_states()
    require(
        before == after,
        "draws from the random numbers that all code of a process shares: use "
        "numpy.random.default_rng(seed) with a seed of its own",
    )


def _random_states() -> str:
    return repr((random.getstate(), np.random.get_state(legacy=False)))  # noqa: NPY002


def _is_quiet(subject: PluginSubject) -> None:
    with redirect_stdout(io.StringIO()) as printed:
        subject.answer()
    text = printed.getvalue()
    require(not text, f"prints {text[:40]!r} to stdout, where commands print JSON: use the module logging")


def is_fast(subject: PluginSubject) -> str:
    """Measure the time of a call; doubt one that takes long."""
    call, on = subject.prepare_call(writable=True)
    start = time.perf_counter()
    call()
    elapsed_s = time.perf_counter() - start
    took = f"{1e3 * elapsed_s:.3g} ms on {on}"
    if elapsed_s > SLOW_S:
        raise DoubtfulError(f"{took}, more than {SLOW_S:g} s: a run does that hundreds of times")
    return took


CLASS_CHECKS = (
    Check("import", partial(require_no_mistake, "import")),
    Check("frozen dataclass", partial(require_no_mistake, "frozen dataclass"), needs=("import",)),
    Check("name", _is_named, needs=("frozen dataclass",)),
    Check(BUILT, _is_built, needs=("frozen dataclass",)),
    Check(CALLABLE, _takes_its_arguments, needs=(BUILT,)),
    Check("parameter types", _is_typed, needs=(BUILT,)),
    Check("canonical parameters", _is_canonical, needs=(BUILT,)),
)


def conduct_checks(answered: str, input_name: str) -> tuple[Check, ...]:
    """Checks of the conduct of a plugin's method, whose answers have passed the check of that name."""

    def leaves_its_input(subject: PluginSubject) -> None:
        call, _ = subject.prepare_call(writable=False)
        try:
            call()
        except ValueError as error:
            if "read-only" not in str(error) and "WRITEABLE" not in str(error):
                raise
            raise CheckFailedError(f"writes to the {input_name} ({error}): copy before changing") from error

    return (
        Check(f"{input_name} unchanged", leaves_its_input, needs=(answered,)),
        Check("repeatable", _repeats, needs=(answered,)),
        Check("no memory", _forgets, needs=("repeatable",)),
        Check("pickling", _is_pickled, needs=("canonical parameters", "repeatable")),
        Check("random numbers", _leaves_random_numbers, needs=(answered,)),
        Check("stdout", _is_quiet, needs=(answered,)),
    )


# Cases.


@dataclass(frozen=True)
class Real:
    """Numbers between two limits, both included."""

    types: ClassVar[tuple[type, ...]] = (int, float)
    noun: ClassVar[str] = "numbers"

    low: float
    high: float
    default: float

    def __contains__(self, value: Any) -> bool:
        return type(value) in self.types and self.low <= value <= self.high

    def __str__(self) -> str:
        return f"{self.noun} from {self.low:g} to {self.high:g}"


class Whole(Real):
    """Integers between two limits, both included."""

    types = (int,)
    noun = "whole numbers"


class Choice:
    """One of a few words or numbers, by default the first."""

    def __init__(self, *values: str | int) -> None:
        self.values, self.default = values, values[0]

    def __contains__(self, value: Any) -> bool:
        return any(type(value) is type(one) and value == one for one in self.values)

    def __str__(self) -> str:
        return f"one of {', '.join(map(str, self.values))}"


Space = Real | Choice
Make = Callable[..., tuple[Any, Sequence[Check]]]


@dataclass(frozen=True, eq=False)
class Family:
    """A family of cases; see `family`.

    Attributes
    ----------
    kind : {"estimator", "detector"}
        Kind of plugin that it is meant for.
    make : callable
        Takes a plugin, a seed of what is random, and the parameters; returns the subject of the checks and
        the checks. Where the first fails, the others are not made.
    table : sequence of tuple
        Parameters of the cases that are always gone through, in the order of the spaces; those that a row
        lacks have their defaults.
    spaces : mapping of str to Space
        By parameter.
    """

    name: str
    kind: Literal["estimator", "detector"]
    make: Make
    table: Sequence[tuple[Any, ...]]
    spaces: Mapping[str, Space]

    @property
    def description(self) -> str:
        """Description of its cases, in a line."""
        return (self.make.__doc__ or "").partition("\n")[0]

    def case(self, **params: Any) -> Case:
        """Make a case, with defaults for what is not given; refuse what lies outside its space."""
        for key in params:
            if key not in self.spaces:
                raise unknown_name(f"parameter of case {self.name}", key, self.spaces)
        values = {key: params.get(key, space.default) for key, space in self.spaces.items()}
        for key, space in self.spaces.items():
            if values[key] not in space:
                raise InputError(f"case {self.name}: {key} = {values[key]!r}; allowed are {space}")
        return Case(self, tuple(values.values()))

    def cases(self) -> list[Case]:
        """Cases of the table."""
        return [self.case(**dict(zip(self.spaces, row, strict=False))) for row in self.table]


@dataclass(frozen=True)
class Case:
    """A case of a family: values of its parameters, in their order."""

    family: Family
    values: tuple[Any, ...]

    @property
    def spec(self) -> str:
        """Specification with all parameters, as `isacbench stress --case` takes it."""
        params = ",".join(map("{}={}".format, self.family.spaces, self.values))
        return f"{self.family.name}[{params}]" if params else self.family.name

    def make(self, plugin: Any, seed: int = 0) -> tuple[Any, Sequence[Check]]:
        """Put plugin and input together into the subject of the checks, and return it with the checks."""
        return self.family.make(plugin, seed, *self.values)


def family(
    table: Iterable[tuple[Any, ...]], *, kind: Literal["estimator", "detector"], **spaces: Space
) -> Callable[[Make], Family]:
    """Make a family of cases of a function that takes a plugin, a seed, and a value of each space.

    Its name is the function's, which ends in an underscore where Python has a function of that name.
    """
    return lambda make: Family(make.__name__.rstrip("_"), kind, make, [*table], spaces)


def with_parameters(plugin: Any, **params: Any) -> Any:
    """Copy a plugin with some parameters replaced; a case says nothing about one that lacks them."""
    fields = {field.name for field in dataclasses.fields(plugin)}
    if missing := sorted(set(params) - fields):
        raise NotApplicableError(f"it has no parameter {missing[0]}")
    return dataclasses.replace(plugin, **params)
