"""Estimators that are objects, on their way to other processes.

A class of a notebook, of a script, or made in a function travels by its code; one that other processes
can import travels by its name, as pickle has it.
"""

from __future__ import annotations

import copy
import dataclasses
import io
import pickle
import sys
from collections import ChainMap
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, ClassVar

import cloudpickle

from isacbench.errors import InputError
from isacbench.plugins.code_digests import ClassCode, class_codes, is_importable, received_codes
from isacbench.plugins.contracts import Estimator


class PickledEstimators(Mapping[str, Estimator]):
    """Estimators that are objects, by the texts that stand for them.

    A copy of them in this process has the same classes. In another process they are
    unpickled where they are first asked for, when the files of their plugins are
    registered, with the codes of their classes as they were when they were sent.
    """

    def __init__(self, estimators: Mapping[str, Estimator] | None = None) -> None:
        self._estimators: Mapping[str, Estimator] | None = estimators or {}
        self._packed: dict[str, bytes] = {}

    def __getitem__(self, text: str) -> Estimator:
        return self._unpacked()[text]

    def __iter__(self) -> Iterator[str]:
        return iter(self._unpacked())

    def __len__(self) -> int:
        return len(self._unpacked())

    def _unpacked(self) -> Mapping[str, Estimator]:
        if self._estimators is None:
            self._estimators = {text: _unpack(packed) for text, packed in self._packed.items()}
        return self._estimators

    def __getstate__(self) -> dict[str, Any]:
        return {"_estimators": None, "_packed": self._packed or _pack(self._unpacked())}

    def __deepcopy__(self, memo: dict[int, Any]) -> PickledEstimators:
        return PickledEstimators(copy.deepcopy(dict(self._unpacked()), memo))


class _Pickler(cloudpickle.Pickler):  # type: ignore[misc]
    """Pickler of classes by their code, for which a field of a dataclass that lacks a default still does."""

    dispatch_table: ClassVar = ChainMap(
        {type(dataclasses.MISSING): lambda _: "MISSING"}, cloudpickle.Pickler.dispatch_table
    )


@contextmanager
def _input_errors(what: str) -> Iterator[None]:
    """Refuse what cannot be pickled, and say what to do."""
    try:
        yield
    except Exception as error:
        raise InputError(
            f"{what} a worker process ({type(error).__name__}: {error}): leave out jobs and dask, or put its "
            "class and what it uses into a module or a plugin file"
        ) from error


def _pack(estimators: Mapping[str, Estimator]) -> dict[str, bytes]:
    """Pickle estimators and the codes of their classes."""
    packed = {}
    for text, one in estimators.items():
        codes = class_codes(one)
        with _by_value(codes.values()), _input_errors(f"estimator {text}: cannot be sent to"):
            _Pickler(buffer := io.BytesIO()).dump((one, codes))
        packed[text] = buffer.getvalue()
    return packed


def _unpack(packed: bytes) -> Estimator:
    with _input_errors("estimators: cannot be had in"):
        estimator, codes = pickle.loads(packed)
    for kind, code in codes.items():
        kind.__qualname__ = code.name  # which cloudpickle does not keep
    received_codes.update(codes)
    return estimator


@contextmanager
def _by_value(codes: Iterable[ClassCode]) -> Iterator[None]:
    """Let cloudpickle send classes of some modules by their code; those of ``__main__`` go so in any case."""
    names = {name for code in codes for name in code.modules} - {"__main__", "builtins"}
    modules = [sys.modules[name] for name in names & sys.modules.keys() if not is_importable(name)]
    for module in modules:
        cloudpickle.register_pickle_by_value(module)
    try:
        yield
    finally:
        for module in modules:
            cloudpickle.unregister_pickle_by_value(module)
