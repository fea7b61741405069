"""Checks of a plugin's class, the same for estimators and detectors."""

from __future__ import annotations

import dataclasses
import inspect
from functools import cached_property
from typing import Any

from isacbench.checking.contract.findings import BrokenContractError, Check
from isacbench.errors import InputError
from isacbench.plugins.discovery import RegisteredPlugin
from isacbench.plugins.local_files import METHODS
from isacbench.plugins.registry import (
    canonical_params,
    check_parameter,
    is_frozen_dataclass,
    parameter_types,
    required_fields,
)

BUILT = "default parameters"
"""Check that yields the instance which all further ones look at."""


class PluginSubject:
    """A plugin's class, and its instance with default parameters.

    Parameters
    ----------
    entry : RegisteredPlugin
    plugin : object, optional
        Instance to look at instead.
    """

    def __init__(self, entry: RegisteredPlugin, plugin: object = None) -> None:
        self.entry = entry
        self._given = plugin

    @cached_property
    def plugin_class(self) -> Any:
        """What is registered."""
        return self.entry.load()

    @cached_property
    def plugin(self) -> Any:
        """Instance with default parameters, unless one is given."""
        return self.plugin_class() if self._given is None else self._given


def _is_imported(subject: PluginSubject) -> str:
    plugin_class, method = subject.plugin_class, METHODS[subject.entry.kind]
    if not inspect.isclass(plugin_class):
        raise BrokenContractError(f"{subject.entry.target} is no class: register the class, not an instance")
    if not callable(getattr(plugin_class, method, None)):
        raise BrokenContractError(f"{plugin_class.__name__} has no method {method!r}: define it")
    return ""


def _is_frozen(subject: PluginSubject) -> str:
    plugin_class = subject.plugin_class
    if not is_frozen_dataclass(plugin_class):
        raise BrokenContractError(
            f"{plugin_class.__name__} is no frozen dataclass: decorate it with @dataclass(frozen=True), so "
            "that its parameters are known and stay as they are"
        )
    return ""


def _is_named(subject: PluginSubject) -> str:
    name = getattr(subject.plugin_class, "name", None)
    if name != subject.entry.name:
        raise BrokenContractError(
            f"it is registered as {subject.entry.name!r}, but its class attribute name is {name!r}: make "
            "them equal"
        )
    if any(field.name == "name" for field in dataclasses.fields(subject.plugin_class)):
        raise BrokenContractError(
            "name is one of its parameters: annotate it as ClassVar[str], for it belongs to the class"
        )
    return ""


def _is_built(subject: PluginSubject) -> str:
    if missing := required_fields(subject.plugin_class):
        raise BrokenContractError(
            f"parameter {missing[0]} has no default: give every parameter one, for results name an "
            "estimator without parameters"
        )
    subject.plugin  # noqa: B018  built here first
    return ""


def _is_typed(subject: PluginSubject) -> str:
    plugin = subject.plugin
    try:
        for name, hint in parameter_types(subject.entry.kind, type(plugin)).items():
            check_parameter(subject.entry.name, name, getattr(plugin, name), hint)
    except InputError as error:
        raise BrokenContractError(f"{error}: make the parameter's default and its type agree") from error
    return ""


def _is_canonical(subject: PluginSubject) -> str:
    try:
        canonical_params(subject.plugin)
    except (TypeError, ValueError) as error:
        raise BrokenContractError(
            f"its parameters cannot be written as JSON ({error}): allowed are finite numbers, words, "
            "booleans, None, tuples of these, and detectors"
        ) from error
    return ""


CLASS_CHECKS: tuple[Check[Any], ...] = (
    Check("import", _is_imported),
    Check("frozen dataclass", _is_frozen, ("import",)),
    Check("name", _is_named, ("frozen dataclass",)),
    Check(BUILT, _is_built, ("frozen dataclass",)),
    Check("parameter types", _is_typed, (BUILT,)),
    Check("canonical parameters", _is_canonical, (BUILT,)),
)
