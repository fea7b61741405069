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
from threading import Lock
from typing import Any, ClassVar

import cloudpickle

from isacbench.errors import InputError
from isacbench.plugins.code_digests import ClassCode, class_codes, is_importable, received_codes
from isacbench.plugins.contracts import Estimator


class Instances(Mapping[str, Estimator]):
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

    def __deepcopy__(self, memo: dict[int, Any]) -> Instances:
        return Instances(copy.deepcopy(dict(self._unpacked()), memo))


class _Pickler(cloudpickle.Pickler):  # type: ignore[misc]
    """Pickler of classes by their code, for which a field of a dataclass that lacks a default still does."""

    dispatch_table: ClassVar = ChainMap(
        {type(dataclasses.MISSING): lambda _: "MISSING"}, cloudpickle.Pickler.dispatch_table
    )


def _pack(estimators: Mapping[str, Estimator]) -> dict[str, bytes]:
    """Pickle estimators and the codes of their classes."""
    packed = {}
    codes = {text: class_codes(one) for text, one in estimators.items()}
    with _by_value(code for own in codes.values() for code in own.values()):
        for text, one in estimators.items():
            try:
                _Pickler(buffer := io.BytesIO()).dump((one, codes[text]))
            except Exception as error:
                reason = f"cannot be sent to a worker process ({type(error).__name__}: {error})"
                raise InputError(
                    f"estimator {text}: {reason}: leave out jobs and dask, or put its class and what it uses "
                    "into a module or a plugin file"
                ) from error
            packed[text] = buffer.getvalue()
    return packed


def _unpack(packed: bytes) -> Estimator:
    try:
        estimator, codes = pickle.loads(packed)
    except Exception as error:
        raise InputError(
            f"estimators: cannot be had in a worker process ({type(error).__name__}: {error}): leave "
            "out jobs and dask, or put the class and what it uses into a module or a plugin file"
        ) from error
    for kind, code in codes.items():
        kind.__qualname__ = code.name  # which cloudpickle does not keep
    received_codes.update(codes)
    return estimator


_packing = Lock()


@contextmanager
def _by_value(codes: Iterable[ClassCode]) -> Iterator[None]:
    """Let cloudpickle send classes of some modules by their code; those of ``__main__`` go so in any case."""
    with _packing:
        names = {name for code in codes for name in code.modules} - {"__main__", "builtins"}
        names -= cloudpickle.list_registry_pickle_by_value()
        modules = [
            sys.modules[name] for name in sorted(names & sys.modules.keys()) if not is_importable(name)
        ]
        try:
            for module in modules:
                cloudpickle.register_pickle_by_value(module)
            yield
        finally:
            for module in modules:
                cloudpickle.unregister_pickle_by_value(module)
