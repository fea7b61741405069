"""Registry of estimators and detectors: builds them by name, with checked parameters."""

from __future__ import annotations

import dataclasses
import inspect
import json
import math
import sys
import warnings
from collections.abc import Iterable, Mapping
from contextlib import redirect_stdout
from functools import lru_cache
from typing import Any, cast, get_args, get_type_hints

from pydantic import ConfigDict, TypeAdapter, ValidationError

from isacbench.added_fields import identity_fields, values_before
from isacbench.errors import InputError, InputWarning, unknown_name
from isacbench.files.escaping import shortened
from isacbench.plugins.contracts import Detector, Estimator
from isacbench.plugins.discovery import PluginKind, RegisteredPlugin, entries
from isacbench.plugins.local_files import METHODS
from isacbench.process_state import libraries_kept, process_state_kept
from isacbench.specifications import QuotedText, Spec, is_word, parse_spec, spec_variants
from isacbench.streams import plugin_output

MOST_BITS = 4096
"""Of an integer that is a parameter."""

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


def sees_truth(name: str) -> bool:
    """Tell whether a registered estimator sees the truth; such a one does not compete.

    Parameters
    ----------
    name : str

    Returns
    -------
    bool

    Raises
    ------
    InputError
        If the name is unknown, or its class breaks the contract.

    Examples
    --------
    >>> sees_truth("oracle"), sees_truth("music2d")
    (True, False)
    """
    return bool(getattr(_load(_registered("estimator", name)), "needs_truth", False))


def require_plugins(kind: PluginKind, specs: Iterable[str]) -> None:
    """Refuse specifications of estimators or detectors that do not exist, with few imports.

    A class is imported only if parameters are given, which must be checked.

    Parameters
    ----------
    kind : {"estimator", "detector"}
    specs : iterable of str
        Grids included, see `isacbench.specifications.spec_variants`.

    Raises
    ------
    InputError
        If a specification is broken, its name is unknown, or one of the
        parameters that it gives is not allowed.

    Examples
    --------
    >>> require_plugins("estimator", ["music2d", "music2d[pfa=[1e-3,1e-4]]"])
    """
    for text in specs:
        for _, spec in spec_variants(text):
            if spec.params:
                _build(kind, spec.name, spec.params)
            else:
                _registered(kind, spec.name)


def build_estimator(spec: str) -> Estimator:
    """Build the one estimator that ``name[param=value,...]`` describes.

    Parameters
    ----------
    spec : str

    Returns
    -------
    Estimator
    """
    name, params = parse_spec(spec)
    return get_estimator(name, **params)


def build_variants(kind: PluginKind, spec: str) -> list[tuple[str, Any]]:
    """Build every plugin that a grid ``name[param=[value,...],...]`` stands for.

    Parameters
    ----------
    kind : {"estimator", "detector"}
    spec : str
        As `isacbench.specifications.spec_variants` takes it.

    Returns
    -------
    list of (str, Estimator or Detector)
        Each plugin with its own specification.

    Raises
    ------
    InputError
        If the grid is broken, or one of its variants cannot be built.

    Examples
    --------
    >>> [text for text, _ in build_variants("estimator", "music2d[pfa=[1e-3,1e-4]]")]
    ['music2d[pfa=1e-3]', 'music2d[pfa=1e-4]']
    """
    return [(text, _build(kind, spec.name, spec.params)) for text, spec in spec_variants(spec)]


def canonical_params(plugin: object) -> str:
    """Write every parameter of a dataclass, such as an estimator or a detector, as canonical JSON.

    Parameters
    ----------
    plugin : Estimator, Detector or other dataclass

    Returns
    -------
    str
        Sorted keys, no spaces, defaults included; a nested detector is an
        object with its ``name`` beside its parameters. Equal parameters give
        equal strings. A field that was added later
        (`isacbench.added_fields.added_field`) is left out at the value that
        stands for the behaviour before.

    Raises
    ------
    InputError
        If a value is not one of `ALLOWED`, naming plugin and parameter.
    """
    return json.dumps(_plain_params(plugin), sort_keys=True, separators=(",", ":"), allow_nan=False)


def parameter_defaults(kind: PluginKind, name: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Look up the defaults of a registered plugin's parameters, in terms of JSON as in `canonical_params`.

    Parameters
    ----------
    kind : {"estimator", "detector"}
    name : str

    Returns
    -------
    defaults, before : dict of str to Any
        Defaults of the parameters that have one. For parameters that were added
        later, the value that means the behaviour before, which canonical
        parameters leave out.

    Raises
    ------
    InputError
        If the name is unknown, or its class breaks the contract.

    Examples
    --------
    >>> defaults, _ = parameter_defaults("estimator", "music2d")
    >>> defaults["detector"]["name"], defaults["detector"]["order_axis"]
    ('osca', 1)
    """
    plugin = _load(_registered(kind, name))
    defaults, before = (
        {key: _plain(f"{kind} {name}", key, value) for key, value in values.items()}
        for values in (field_defaults(plugin), values_before(plugin))
    )
    return defaults, before


def distribution(kind: PluginKind, name: str) -> str:
    """Look up name and version of the package that registers a name, such as ``isacbench 0.1.0``.

    Parameters
    ----------
    kind : {"estimator", "detector"}
    name : str

    Returns
    -------
    str
    """
    return entries(kind)[name].origin


def describe_plugin(kind: PluginKind) -> list[dict[str, Any]]:
    """Describe every registered estimator or detector.

    Parameters
    ----------
    kind : {"estimator", "detector"}

    Returns
    -------
    list of dict
        ``name``, ``description`` (one line), ``parameters`` (name to ``type``
        and, where there is one, ``default``) and ``package``. What is broken
        is left out.

    Raises
    ------
    InputError
        If a plugin of a local file is broken.

    Warns
    -----
    InputWarning
        If one of a package is.
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
    plugin = _load(entry)
    parameters: dict[str, dict[str, Any]] = {
        key: {"type": inspect.formatannotation(hint, base_module=Detector.__module__)}
        for key, hint in parameter_types(entry.kind, plugin).items()
    }
    for key, value in _checked_defaults(entry.kind, plugin).items():
        parameters[key]["default"] = _plain(f"{entry.kind} {entry.name}", key, value)
    return {
        "name": entry.name,
        "description": (inspect.getdoc(plugin) or "").partition("\n")[0],
        "parameters": parameters,
        "package": entry.origin,
    }


def _checked_defaults(kind: str, plugin: type[Any]) -> dict[str, Any]:
    """Defaults of the parameters of a plugin, which are checked as values that are given."""
    where = f"{kind} {plugin.name}"
    hints = parameter_types(kind, plugin)
    try:
        defaults = field_defaults(plugin)
    except Exception as error:  # of a factory
        raise InputError(f"{where} cannot be built: {type(error).__name__}: {error}") from error
    for key, value in defaults.items():
        _plain(where, key, value)
        check_parameter(where, key, value, hints[key])
    return defaults


def _registered(kind: PluginKind, name: str) -> RegisteredPlugin:
    """Look up a registered name."""
    registered = entries(kind)
    if name not in registered:
        raise unknown_name(kind, name, sorted(registered))
    return registered[name]


def _load(entry: RegisteredPlugin) -> type[Any]:
    """Import a plugin's class and check it against the contract."""
    where = f"{entry.kind} {entry.name!r} ({entry.target} of {entry.origin})"
    try:
        plugin = _imported(entry)
    except (Exception, SystemExit) as error:
        raise InputError(f"{where} cannot be loaded: {type(error).__name__}: {error}") from error
    if not is_frozen_dataclass(plugin):
        raise InputError(f"{where} must be a frozen dataclass")
    if not callable(getattr(plugin, METHODS[entry.kind], None)):
        raise InputError(f"{where} must have a method {METHODS[entry.kind]!r}")
    name = getattr(plugin, "name", None)
    if name != entry.name:
        raise InputError(f"{where} must have the class attribute name = {entry.name!r}, not {name!r}")
    if not is_word(name):
        raise InputError(f'{where}: its name must be a word without any of []()=," and spaces, and no number')
    return cast("type[Any]", plugin)


def _imported(entry: RegisteredPlugin) -> Any:
    """Import a plugin; the package of somebody else leaves this process as it was."""
    if (
        entry.module in sys.modules
        or entry.module.startswith("isacbench_algorithms.")
        or entry.version is None
    ):
        return entry.load()
    with process_state_kept(at_import=True), libraries_kept(), redirect_stdout(sys.stderr):
        return entry.load()


def is_frozen_dataclass(plugin: object) -> bool:
    """Tell whether an object is a class, a dataclass and frozen.

    Parameters
    ----------
    plugin : object

    Returns
    -------
    bool
    """
    parameters = getattr(plugin, "__dataclass_params__", None)
    return inspect.isclass(plugin) and bool(getattr(parameters, "frozen", False))


def _build(kind: PluginKind, name: str, params: dict[str, Any]) -> Any:
    """Instance of a registered class with checked parameters."""
    if "[" in name:
        raise InputError(f"{kind} {name!r}: give the name only; pass parameters as keyword arguments")
    return construct(kind, name, _load(_registered(kind, name)), params)


@plugin_output()
def construct(kind: str, name: str, plugin: type[Any], params: Mapping[str, Any]) -> Any:
    """Build a dataclass; its parameters are checked against the types of its fields.

    Parameters
    ----------
    kind, name : str
        Kind and name of the object in messages.
    plugin : type
        A dataclass with a class attribute ``name``.
    params : mapping of str to Any

    Returns
    -------
    object

    Raises
    ------
    InputError
        If a parameter is unknown or missing, or a value is not allowed.
    """
    hints = parameter_types(kind, plugin)
    for key in params:
        if key not in hints:
            raise unknown_name(f"parameter of {kind} {name}", key, hints)
    checked = {
        key: check_parameter(f"{kind} {name}", key, value, hints[key]) for key, value in params.items()
    }
    _checked_defaults(kind, plugin)
    missing = [name for name in required_fields(plugin) if name not in checked]
    if missing:
        raise InputError(f"{kind} {name}: missing parameter {', '.join(missing)}")
    try:
        return plugin(**checked)
    except ValueError as error:
        raise InputError(f"{kind} {name}: {error}") from error
    except Exception as error:
        raise InputError(f"{kind} {name} cannot be built: {type(error).__name__}: {error}") from error


def required_fields(plugin: Any) -> list[str]:
    """List the fields of a dataclass that have no default.

    Parameters
    ----------
    plugin : type or object
        A dataclass, or an instance of one.

    Returns
    -------
    list of str
    """
    return [
        field.name
        for field in parameter_fields(plugin)
        if field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
    ]


def field_defaults(plugin: Any) -> dict[str, Any]:
    """Collect the defaults of the fields of a dataclass that have one.

    Parameters
    ----------
    plugin : type or object
        A dataclass, or an instance of one.

    Returns
    -------
    dict of str to Any
    """
    return {
        field.name: field.default if field.default_factory is dataclasses.MISSING else field.default_factory()
        for field in parameter_fields(plugin)
        if field.name not in required_fields(plugin)
    }


def parameter_types(kind: str, plugin: type[Any]) -> dict[str, Any]:
    """Resolve the types of a plugin's fields; `Detector` may be imported for type checking only.

    Parameters
    ----------
    kind : str
        Kind of the plugin in messages.
    plugin : type
        A dataclass with a class attribute ``name``.

    Returns
    -------
    dict of str to type
    """
    try:
        hints = get_type_hints(plugin, localns={"Detector": Detector}, include_extras=True)
    except NameError as error:
        raise InputError(
            f"{kind} {plugin.name}: the type of a parameter cannot be resolved ({error}): "
            "import it at run time, not under TYPE_CHECKING"
        ) from error
    refuse_init_variables(kind, plugin)
    return {field.name: hints[field.name] for field in parameter_fields(plugin)}


def refuse_init_variables(kind: str, plugin: type[Any]) -> None:
    """Refuse a dataclass with values that its instances do not keep: no row could name them.

    Parameters
    ----------
    kind : str
        Kind of the plugin in messages.
    plugin : type

    Raises
    ------
    InputError
        Naming the first one.
    """
    for base in plugin.__mro__:
        for key, hint in vars(base).get("__annotations__", {}).items():
            if "InitVar" in str(hint):
                raise InputError(
                    f"{kind} {plugin.name}: {key} is an InitVar, which is not kept: make it a field"
                )


def parameter_fields(plugin: Any) -> list[dataclasses.Field[Any]]:
    """List the fields of a dataclass that are parameters, and not made of others.

    Parameters
    ----------
    plugin : type or object
        A dataclass, or an instance of one.

    Returns
    -------
    list of dataclasses.Field
    """
    return [field for field in dataclasses.fields(plugin) if field.init]


def check_parameter(where: str, key: str, value: Any, hint: Any) -> Any:
    """Check a value of a parameter against the type of its field, and build a nested detector.

    Parameters
    ----------
    where, key : str
        Plugin and parameter in messages.
    value : object
    hint : type

    Returns
    -------
    object
        Value to pass to the field.

    Raises
    ------
    InputError
        If the value is not allowed.
    """
    error: ValidationError
    for none in (None, "none") if _has_none(value) else ("none",):
        try:
            return _adapter(hint).validate_python(_meant(value, hint, none))
        except ValidationError as refused:
            error = refused
    # A union reports what each of its members wants.
    wanted = " or ".join(
        dict.fromkeys(found["msg"].removeprefix("Input should be ") for found in error.errors())
    )
    shown = f"{value.name}[...]" if isinstance(value, Spec) else repr(value)
    raise InputError(f"{where}: {key} = {shown}: should be {wanted}") from error


@lru_cache(maxsize=256)
def _adapter(hint: Any) -> TypeAdapter[Any]:
    config = ConfigDict(strict=True, arbitrary_types_allowed=True, allow_inf_nan=False)
    return TypeAdapter(hint, config=config)


def _has_none(value: Any) -> bool:
    """Tell whether the word none is among values, which means no value where a field takes that."""
    if isinstance(value, tuple) and not isinstance(value, Spec):
        return any(map(_has_none, value))
    return isinstance(value, str) and value == "none" and not isinstance(value, QuotedText)


def _meant(value: Any, hint: Any, none: str | None) -> Any:
    """Value that a specification, the word none, or a number of NumPy stands for."""
    if isinstance(value, Spec):
        return get_detector(value.name, **value.params) if _takes_detectors(hint) else value
    if isinstance(value, tuple):
        return tuple(_meant(one, hint, none) for one in value)
    if _has_none(value) and none is None:
        return None
    if isinstance(value, str):
        return get_detector(value) if _takes_detectors(hint) else str(value)
    return _number(value)


def _takes_detectors(hint: Any) -> bool:
    return hint is Detector or any(map(_takes_detectors, get_args(hint)))


def _number(value: Any) -> Any:
    """Python's number, text or truth value for one of NumPy."""
    return (
        value.item() if type(value).__module__ == "numpy" and getattr(value, "shape", None) == () else value
    )


def _plain_params(plugin: Any) -> dict[str, Any]:
    kind = next((kind for kind, method in METHODS.items() if hasattr(plugin, method)), "class")
    where = f"{kind} {getattr(plugin, 'name', type(plugin).__name__)}"
    given = {field.name for field in parameter_fields(plugin)}
    values = identity_fields(plugin)
    return {name: _plain(where, name, value) for name, value in values.items() if name in given}


def _plain(where: str, key: str, value: Any) -> Any:
    """Convert a parameter's value to types of JSON, or refuse it."""
    value = _number(value)
    if value is None or type(value) is bool or (type(value) is float and math.isfinite(value)):
        return value
    if type(value) is int and value.bit_length() <= MOST_BITS:
        return value
    if _is_unicode(value):
        return str(value)
    if type(value) is tuple:
        return [_plain(where, key, item) for item in value]
    if dataclasses.is_dataclass(value) and not isinstance(value, type) and isinstance(value, Detector):
        return {"name": value.name, **_plain_params(value)}
    shown = hex(value) if type(value) is int else repr(value)  # decimal digits have a limit in Python
    shown = " ".join(shortened(shown).split())
    raise InputError(f"{where}: {key} = {shown}: allowed are {ALLOWED}")


def _is_unicode(value: Any) -> bool:
    """Tell whether something is a text that can be stored: one without halves of characters."""
    return type(value) in (str, QuotedText) and value.encode(errors="replace").decode() == value
