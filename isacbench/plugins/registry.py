"""Registry of estimators, detectors and metrics: builds them by name, with checked parameters.

The parameters of a plugin are the fields of its dataclass. An estimator that is an object is spelled by them.
"""

from __future__ import annotations

import dataclasses
import inspect
import json
import math
import sys
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import nullcontext
from functools import lru_cache
from typing import Any, cast, get_args, get_type_hints

from pydantic import ConfigDict, TypeAdapter, ValidationError

from isacbench.errors import InputError, InputWarning, unknown_name
from isacbench.files.escaping import shortened
from isacbench.metrics.descriptions import ScoreColumn
from isacbench.plugins.contracts import Detector, Estimator, Metric
from isacbench.plugins.discovery import METHODS, PluginKind, RegisteredPlugin, entries
from isacbench.process_state import plugin_output, process_state_kept
from isacbench.specifications import QuotedText, Spec, is_word, parse_spec, spec_variants, spell_spec

ALLOWED = "finite numbers, texts, booleans, none, tuples of these, and detectors"
"""Values of parameters, which a run can store, a command can spell, and another process can have."""


def estimator_names() -> list[str]:
    """List the names of the registered estimators, sorted."""
    return sorted(entries("estimator"))


def detector_names() -> list[str]:
    """List the names of the registered detectors, sorted."""
    return sorted(entries("detector"))


def get_estimator(name: str, **params: Any) -> Estimator:
    """Build a registered estimator.

    Parameters
    ----------
    name : str
        A name that `estimator_names` lists.
    **params
        Fields of the estimator's dataclass. For a field that holds a detector,
        the value is a `Detector`, its name, or a `Spec`.

    Returns
    -------
    Estimator
        ``oracle`` and ``chance`` are a `isacbench.plugins.contracts.ReferenceEstimator`, and take
        the truth as well.

    Raises
    ------
    InputError
        If the name or a parameter is unknown, or a value is not allowed.

    Examples
    --------
    >>> get_estimator("music2d", integration="element").name
    'music2d'
    """
    return cast("Estimator", _build("estimator", name, params))


def get_detector(name: str, **params: Any) -> Detector:
    """Build a registered detector.

    Parameters
    ----------
    name : str
        A name that `detector_names` lists.
    **params
        Fields of the detector's dataclass.

    Returns
    -------
    Detector

    Raises
    ------
    InputError
        If the name or a parameter is unknown, or a value is not allowed.

    Examples
    --------
    >>> get_detector("osca", pfa=1e-4).pfa
    0.0001
    """
    return cast("Detector", _build("detector", name, params))


def metric_names() -> list[str]:
    """List the names of the registered metrics, sorted."""
    return sorted(entries("metric"))


def get_metric(name: str, **params: Any) -> Metric:
    """Build a registered metric.

    Parameters
    ----------
    name : str
        A name that `metric_names` lists.
    **params
        Fields of the metric's dataclass.

    Returns
    -------
    Metric

    Raises
    ------
    InputError
        If the name or a parameter is unknown, or a value is not allowed.

    Examples
    --------
    >>> get_metric("objects", gate_m=3.0).gate_m
    3.0
    """
    return cast("Metric", _build("metric", name, params))


def build_metric(spec: str) -> Metric:
    """Build the one metric that ``name[param=value,...]`` describes."""
    name, params = parse_spec(spec)
    return get_metric(name, **params)


def sees_truth(name: str) -> bool:
    """Tell whether a registered estimator sees the truth; such a one does not compete.

    Examples
    --------
    >>> sees_truth("oracle"), sees_truth("music2d")
    (True, False)
    """
    return bool(getattr(_load(registered("estimator", name)), "needs_truth", False))


def require_plugins(kind: PluginKind, specs: Iterable[str]) -> None:
    """Refuse specifications of plugins that do not exist, grids included, with few imports.

    A class is imported only if parameters are given, which must be checked.
    """
    for text in specs:
        for _, spec in spec_variants(text):
            if spec.params:
                _build(kind, spec.name, spec.params)
            else:
                registered(kind, spec.name)


def build_estimator(spec: str) -> Estimator:
    """Build the one estimator that ``name[param=value,...]`` describes."""
    name, params = parse_spec(spec)
    return get_estimator(name, **params)


def build_variants(kind: PluginKind, spec: str) -> list[tuple[str, Any]]:
    """Build every plugin that a grid ``name[param=[value,...],...]`` stands for, each with its specification.

    Examples
    --------
    >>> [text for text, _ in build_variants("estimator", "music2d[pfa=[1e-3,1e-4]]")]
    ['music2d[pfa=1e-3]', 'music2d[pfa=1e-4]']
    """
    return [(text, _build(kind, spec.name, spec.params)) for text, spec in spec_variants(spec)]


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
        text = one if isinstance(one, str) else _specification_of(one)
        if text in found:
            raise InputError(f"estimators: {text!r} is listed twice")
        found[text] = None if isinstance(one, str) else one
    return found


def _specification_of(estimator: object) -> str:
    """Name of an object and its parameters, as a specification shows them."""
    plugin = type(estimator)
    name = getattr(plugin, "name", None)
    has_method = callable(getattr(plugin, "estimate", None))
    if not (is_frozen_dataclass(plugin) and isinstance(name, str) and is_word(name) and has_method):
        raise InputError(
            f"estimators: {estimator!r:.80}: allowed are specifications such as 'music2d[pfa=1e-4]' and "
            "instances of frozen dataclasses with a name, a word, and a method estimate"
        )
    return spell_spec(name, _unlike_defaults(estimator, json.loads(canonical_params(estimator))))


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


def parameter_defaults(kind: PluginKind, name: str) -> dict[str, Any]:
    """Look up the defaults of a registered plugin's parameters, in terms of JSON as in `canonical_params`.

    Examples
    --------
    >>> defaults = parameter_defaults("estimator", "music2d")
    >>> defaults["detector"]["name"], defaults["detector"]["order_axis"]
    ('osca', 1)
    """
    defaults = field_defaults(_load(registered(kind, name)))
    return {key: plain_value(f"{kind} {name}", key, value) for key, value in defaults.items()}


def describe_plugin(kind: PluginKind) -> list[dict[str, Any]]:
    """Describe every registered plugin of a kind: name, description in a line, parameters and package.

    Parameters have a ``type`` and perhaps a ``default``. A broken plugin of a package is left out with a
    warning; that of a file is refused.
    """
    described = []
    for _, entry in sorted(entries(kind).items()):
        try:
            described.append(_described(entry))
        except InputError as error:
            if entry.version is None:  # of a file that the user has named
                raise
            warnings.warn(str(error), InputWarning, stacklevel=2)
    return described


@plugin_output()
def _described(entry: RegisteredPlugin) -> dict[str, Any]:
    """Name, description, parameters and package of a plugin."""
    plugin, where = _load(entry), f"{entry.kind} {entry.name}"
    defaults = _checked_params(where, plugin, parameter_types(entry.kind, plugin), {})
    parameters = {
        key: {"type": inspect.formatannotation(hint, base_module=Detector.__module__)}
        | ({"default": plain_value(where, key, defaults[key])} if key in defaults else {})
        for key, hint in parameter_types(entry.kind, plugin).items()
    }
    return {
        "name": entry.name,
        "description": (inspect.getdoc(plugin) or "").partition("\n")[0],
        "parameters": parameters,
        "package": entry.origin,
    }


def _checked_params(
    where: str, plugin: type[Any], hints: Mapping[str, Any], params: Mapping[str, Any]
) -> dict[str, Any]:
    """Defaults of a plugin's parameters, or the values given instead, checked and converted."""
    try:
        defaults = field_defaults(plugin)
    except Exception as error:  # of a factory
        raise InputError(f"{where} cannot be built: {type(error).__name__}: {error}") from error
    checked = {}
    for key, value in {**defaults, **params}.items():
        if key not in params:
            plain_value(where, key, value)
        meant = check_parameter(where, key, value, hints[key])
        # Texts of defaults stay what they are, as if in quotes.
        checked[key] = value if key not in params and isinstance(value, (str, tuple)) else meant
    return checked


def registered(kind: PluginKind, name: str) -> RegisteredPlugin:
    """Look up a registered name."""
    known = entries(kind)
    if name not in known:
        raise unknown_name(kind, name, sorted(known))
    return known[name]


def _load(entry: RegisteredPlugin) -> type[Any]:
    """Import a plugin's class and check it against the contract."""
    where = f"{entry.kind} {entry.name!r} ({entry.target} of {entry.origin})"
    try:
        with nullcontext() if entry.module in sys.modules else process_state_kept(at_import=True):
            plugin = entry.load()
    except (Exception, SystemExit) as error:
        raise InputError(f"{where} cannot be loaded: {type(error).__name__}: {error}") from error
    for _, mistake in class_mistakes(entry, plugin):
        raise InputError(f"{where}: {mistake}")
    return cast("type[Any]", plugin)


def class_mistakes(entry: RegisteredPlugin, plugin: Any) -> Iterator[tuple[str, str]]:
    """Find what a registered object lacks to be a plugin: the check that fails, what is wrong, what to do."""
    if not inspect.isclass(plugin):
        yield "import", f"{entry.target} is no class: register the class, not an instance"
        return
    title, name, columns = plugin.__name__, getattr(plugin, "name", None), getattr(plugin, "columns", None)
    if not callable(getattr(plugin, METHODS[entry.kind], None)):
        yield "import", f"{title} has no method {METHODS[entry.kind]!r}: define it"
    if not is_frozen_dataclass(plugin):
        yield "frozen dataclass", f"{title} is no frozen dataclass: decorate it with @dataclass(frozen=True)"
    if name != entry.name:
        yield (
            "name",
            f"registered as {entry.name!r}, but its class attribute name is {name!r}: make them equal",
        )
    if not is_word(entry.name):
        yield "name", f'its name {name!r} is no word: allowed are no spaces, none of []()=," and no number'
    if entry.kind != "metric":
        return
    if not isinstance(columns, tuple) or not all(isinstance(one, ScoreColumn) for one in columns):
        yield "columns", f"columns is {columns!r}: make it a tuple of isacbench.plugins.contracts.ScoreColumn"
    elif not 0 < len(columns) == len({one.name for one in columns}):
        yield "columns", "columns has none, or two of one name: give each score a name of its own"


def _build(kind: PluginKind, name: str, params: dict[str, Any]) -> Any:
    """Instance of a registered class with checked parameters."""
    if "[" in name:
        raise InputError(f"{kind} {name!r}: give the name only; pass parameters as keyword arguments")
    return construct(kind, name, _load(registered(kind, name)), params)


@plugin_output()
def construct(kind: str, name: str, plugin: type[Any], params: Mapping[str, Any]) -> Any:
    """Build a dataclass with a class attribute ``name``; values are checked against the types of its fields.

    Kind and name are those in messages.
    """
    where, hints = f"{kind} {name}", parameter_types(kind, plugin)
    for key in params:
        if key not in hints:
            raise unknown_name(f"parameter of {where}", key, hints)
    checked = _checked_params(where, plugin, hints, params)
    if missing := [name for name in required_fields(plugin) if name not in checked]:
        raise InputError(f"{where}: missing parameter {', '.join(missing)}")
    try:
        return plugin(**checked)
    except ValueError as error:
        raise InputError(f"{where}: {error}") from error
    except Exception as error:
        raise InputError(f"{where} cannot be built: {type(error).__name__}: {error}") from error


def check_parameter(where: str, key: str, value: Any, hint: Any) -> Any:
    """Check a value against the type of its field, and build nested detectors; `where` is for messages."""
    error: ValidationError
    for none in (None, "none"):  # the word means no value where the field takes that
        try:
            return _adapter(hint).validate_python(_with_none(value, hint, none))
        except ValidationError as refused:
            error = refused
    # A union reports what each of its members wants.
    wanted = dict.fromkeys(found["msg"].removeprefix("Input should be ") for found in error.errors())
    shown = f"{value.name}[...]" if isinstance(value, Spec) else repr(value)
    raise InputError(f"{where}: {key} = {shown}: should be {' or '.join(wanted)}") from error


@lru_cache(maxsize=256)
def _adapter(hint: Any) -> TypeAdapter[Any]:
    config = ConfigDict(strict=True, arbitrary_types_allowed=True, allow_inf_nan=False)
    return TypeAdapter(hint, config=config)


def _with_none(value: Any, hint: Any, none: str | None) -> Any:
    """Value that a specification, the word none, or a number of NumPy stands for."""
    if isinstance(value, Spec):
        return get_detector(value.name, **value.params) if _takes_detectors(hint) else value
    if isinstance(value, tuple):
        return tuple(_with_none(one, hint, none) for one in value)
    if isinstance(value, str):
        if value == "none" and none is None and not isinstance(value, QuotedText):
            return None
        return get_detector(value) if _takes_detectors(hint) else str(value)
    return python_number(value)


def _takes_detectors(hint: Any) -> bool:
    return hint is Detector or any(map(_takes_detectors, get_args(hint)))


def canonical_params(plugin: object) -> str:
    """Write every parameter of a dataclass, such as an estimator or a detector, as canonical JSON.

    Sorted keys, no spaces, defaults included; a nested detector is an object with its ``name`` beside its
    parameters. Equal parameters give equal strings. A value that is not one of `ALLOWED` is refused, naming
    plugin and parameter.
    """
    return json.dumps(_plain_params(plugin), sort_keys=True, separators=(",", ":"), allow_nan=False)


def is_frozen_dataclass(plugin: object) -> bool:
    """Tell whether an object is a class, a dataclass and frozen."""
    parameters = getattr(plugin, "__dataclass_params__", None)
    return inspect.isclass(plugin) and bool(getattr(parameters, "frozen", False))


def parameter_fields(plugin: Any) -> list[dataclasses.Field[Any]]:
    """List the fields of a dataclass, or of an instance, that are parameters and not made of others."""
    return [field for field in dataclasses.fields(plugin) if field.init]


def required_fields(plugin: Any) -> list[str]:
    """List the fields of a dataclass that have no default."""
    fields, missing = parameter_fields(plugin), dataclasses.MISSING
    return [one.name for one in fields if one.default is missing and one.default_factory is missing]


def field_defaults(plugin: Any) -> dict[str, Any]:
    """Collect the defaults of the fields of a dataclass that have one."""
    return {
        field.name: field.default if field.default_factory is dataclasses.MISSING else field.default_factory()
        for field in parameter_fields(plugin)
        if field.name not in required_fields(plugin)
    }


def parameter_types(kind: str, plugin: type[Any]) -> dict[str, Any]:
    """Resolve the types of a plugin's fields; `Detector` may be imported for type checking only."""
    try:
        hints = get_type_hints(plugin, localns={"Detector": Detector}, include_extras=True)
    except NameError as error:
        raise InputError(
            f"{kind} {plugin.name}: the type of a parameter cannot be resolved ({error}): "
            "import it at run time, not under TYPE_CHECKING"
        ) from error
    return {field.name: hints[field.name] for field in parameter_fields(plugin)}


def plain_value(where: str, key: str, value: Any) -> Any:
    """Convert a parameter's value to types of JSON, or refuse it; plugin and key are for messages."""
    value = python_number(value)
    if value is None or type(value) in (bool, int) or (type(value) is float and math.isfinite(value)):
        return value
    if type(value) in (str, QuotedText):
        return str(value)
    if type(value) is tuple:
        return [plain_value(where, key, item) for item in value]
    if dataclasses.is_dataclass(value) and not isinstance(value, type) and isinstance(value, Detector):
        return {"name": value.name, **_plain_params(value)}
    shown = shortened(" ".join(repr(value).split()))
    raise InputError(f"{where}: {key} = {shown}: allowed are {ALLOWED}")


def _plain_params(plugin: Any) -> dict[str, Any]:
    kind = next((kind for kind, method in METHODS.items() if hasattr(plugin, method)), "class")
    where = f"{kind} {getattr(plugin, 'name', type(plugin).__name__)}"
    fields = parameter_fields(plugin)
    return {field.name: plain_value(where, field.name, getattr(plugin, field.name)) for field in fields}


def python_number(value: Any) -> Any:
    """Take Python's number, text or truth value for one of NumPy; other values stay."""
    is_numpys = type(value).__module__ == "numpy" and getattr(value, "shape", None) == ()
    return value.item() if is_numpys else value
