"""Estimators as objects instead of names: spelled for a suite, and sent to other processes.

A class that another process can import travels by its name, as pickle has it.
One of a script, of a notebook or of a test travels by its code.
"""

from __future__ import annotations

import copy
import dataclasses
import io
import json
import pickle
import sys
from collections import ChainMap
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from threading import Lock
from typing import Any, ClassVar

import cloudpickle

from isacbench.errors import InputError
from isacbench.plugins.code_digests import is_importable, known_codes, own_codes
from isacbench.plugins.contracts import Estimator
from isacbench.plugins.registry import (
    canonical_params,
    check_parameter,
    field_defaults,
    is_frozen_dataclass,
    parameter_types,
    refuse_init_variables,
)
from isacbench.specifications import is_word, spell_spec


def spelled_estimators(estimators: Iterable[str | Estimator]) -> dict[str, Estimator | None]:
    """Spell estimators, in order; objects by name and parameters, texts as they are and with None.

    Examples
    --------
    >>> from isacbench import get_estimator
    >>> list(spelled_estimators(["fft4d", get_estimator("music2d", pfa=1e-4)]))
    ['fft4d', 'music2d[pfa=0.0001]']
    """
    if isinstance(estimators, str) or not isinstance(estimators, Iterable):
        raise InputError(f"estimators {estimators!r}: allowed is a list, such as [{estimators!r}]")
    found: dict[str, Estimator | None] = {}
    for one in estimators:
        text = one if isinstance(one, str) else _spelled(one)
        if text in found:
            raise InputError(f"estimators: {text!r} is listed twice")
        found[text] = None if isinstance(one, str) else one
    return found


def _spelled(estimator: object) -> str:
    """Name of an object and its parameters, as a specification shows them."""
    plugin = type(estimator)
    name = getattr(plugin, "name", None)
    has_method = callable(getattr(plugin, "estimate", None))
    if not (is_frozen_dataclass(plugin) and isinstance(name, str) and is_word(name) and has_method):
        raise InputError(
            f"estimators: {estimator!r:.80}: allowed are specifications such as 'music2d[pfa=1e-4]' and "
            "instances of frozen dataclasses with a name, a word, and a method estimate"
        )
    refuse_init_variables("estimator", plugin)
    text = spell_spec(name, _unlike_defaults(estimator, json.loads(canonical_params(estimator))))
    hints: dict[str, Any] = {}
    with suppress(Exception):  # types that only a function knows cannot be resolved
        hints = parameter_types("estimator", plugin)
    for key, hint in hints.items():
        check_parameter(f"estimator {name}", key, getattr(estimator, key), hint)
    return text


def _unlike_defaults(plugin: Any, params: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters in terms of JSON without those that are as by default, of nested plugins likewise."""
    unlike: dict[str, Any] = {}
    for field in dataclasses.fields(plugin):
        value = getattr(plugin, field.name)
        if field.name in params and value != field_defaults(plugin).get(field.name, dataclasses.MISSING):
            own = params[field.name]
            is_plugin = isinstance(own, dict)
            unlike[field.name] = {"name": own["name"], **_unlike_defaults(value, own)} if is_plugin else own
    return unlike


class Instances(Mapping[str, "Estimator"]):
    """Estimators that are objects, by the texts that stand for them.

    A copy of them in this process has the same classes. In another process they are
    unpickled where they are first asked for, when the files of their plugins are
    registered, with the codes of their classes as they were when they were sent.
    """

    def __init__(self, estimators: Mapping[str, Estimator] | None = None) -> None:
        self._estimators: Mapping[str, Estimator] | None = estimators or {}
        self._packed = b""

    def __getitem__(self, text: str) -> Estimator:
        return self._unpacked()[text]

    def __iter__(self) -> Iterator[str]:
        return iter(self._unpacked())

    def __len__(self) -> int:
        return len(self._unpacked())

    def _unpacked(self) -> Mapping[str, Estimator]:
        if self._estimators is None:
            try:
                self._estimators, codes = pickle.loads(self._packed)
            except Exception as error:
                raise InputError(
                    f"estimators: cannot be had in a worker process ({type(error).__name__}: {error}): leave "
                    "out jobs and dask, or put the class and what it uses into a module or a plugin file"
                ) from error
            for cls, code in codes.items():
                cls.__qualname__ = code.name  # which cloudpickle does not keep
            known_codes.update(codes)
        return self._estimators

    def __getstate__(self) -> dict[str, Any]:
        return {"_estimators": None, "_packed": self._packed or _packed(self._unpacked())}

    def __deepcopy__(self, memo: dict[int, Any]) -> Instances:
        return Instances(copy.deepcopy(dict(self._unpacked()), memo))


class _Pickler(cloudpickle.Pickler):  # type: ignore[misc]
    """Pickler of classes by their code, for which a field of a dataclass that lacks a default still does."""

    dispatch_table: ClassVar = ChainMap(
        {type(dataclasses.MISSING): lambda _: "MISSING"}, cloudpickle.Pickler.dispatch_table
    )


def _packed(estimators: Mapping[str, Estimator]) -> bytes:
    """Pickle estimators, those by their code whose modules no other process can import."""
    packed = io.BytesIO()
    with _packing, _by_value(estimators.values()):
        for text, one in estimators.items():
            try:
                _Pickler(io.BytesIO()).dump(one)
            except Exception as error:
                reason = f"cannot be sent to a worker process ({type(error).__name__}: {error})"
                raise InputError(
                    f"estimator {text}: {reason}: leave out jobs and dask, or put its class and what it uses "
                    "into a module or a plugin file"
                ) from error
        codes = [own_codes(one) for one in estimators.values()]
        _Pickler(packed).dump((dict(estimators), dict(ChainMap(*codes))))
    return packed.getvalue()


_packing = Lock()


@contextmanager
def _by_value(plugins: Iterable[object]) -> Iterator[None]:
    """Let cloudpickle send classes of some modules by their code; those of ``__main__`` go so in any case."""
    codes = (code for plugin in plugins for code in own_codes(plugin).values())
    names = {name for code in codes for name in code.modules} - {"__main__", "builtins"}
    names -= cloudpickle.list_registry_pickle_by_value()
    modules = [sys.modules[name] for name in sorted(names & sys.modules.keys()) if not is_importable(name)]
    try:
        for module in modules:
            cloudpickle.register_pickle_by_value(module)
        yield
    finally:
        for module in modules:
            cloudpickle.unregister_pickle_by_value(module)
