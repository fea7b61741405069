"""Names to estimators and detectors: found through entry points, parameters parsed, checked and filled in."""

from __future__ import annotations

import dataclasses
import inspect
import json
import re
from importlib.metadata import EntryPoint, entry_points
from typing import Any, ClassVar, Literal, NamedTuple, cast, get_args, get_type_hints

from pydantic import ConfigDict, TypeAdapter, ValidationError

from isacbench.contracts import Detector, Estimator, TruthEstimator
from isacbench.errors import InputError, unknown_name

__all__ = [
    "AnyEstimator",
    "Spec",
    "build_estimator",
    "canonical_params",
    "describe",
    "detector_names",
    "distribution",
    "estimator_names",
    "get_detector",
    "get_estimator",
    "parse_spec",
]

Kind = Literal["estimator", "detector"]
AnyEstimator = Estimator | TruthEstimator

GROUPS: dict[Kind, str] = {"estimator": "isacbench.estimators", "detector": "isacbench.detectors"}
METHODS: dict[Kind, str] = {"estimator": "estimate", "detector": "detect"}


class Spec(NamedTuple):
    """A name and its parameters, as ``name[param=value,...]`` spells them."""

    name: str
    params: dict[str, Any]


def estimator_names() -> list[str]:
    """Names of the registered estimators, sorted."""
    return sorted(_entry_points("estimator"))


def detector_names() -> list[str]:
    """Names of the registered detectors, sorted."""
    return sorted(_entry_points("detector"))


def get_estimator(name: str, **params: Any) -> AnyEstimator:
    """Build a registered estimator.

    Parameters
    ----------
    name : str
        A name that `estimator_names` lists.
    **params
        Fields of the estimator's dataclass. Where a field holds a detector,
        the value is a `Detector`, its name, or a `Spec`.

    Returns
    -------
    Estimator or TruthEstimator

    Raises
    ------
    InputError
        If the name or a parameter is unknown, or a value is not allowed.

    Examples
    --------
    >>> get_estimator("music2d", integration="element").name
    'music2d'
    """
    return cast("AnyEstimator", _build("estimator", name, params))


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


def build_estimator(spec: str) -> AnyEstimator:
    """Build the estimator that ``name[param=value,...]`` describes; see `parse_spec`."""
    name, params = parse_spec(spec)
    return get_estimator(name, **params)


def parse_spec(text: str) -> Spec:
    """Parse ``name[param=value,...]``.

    A value is an integer, a float, ``true``, ``false``, a bare word, a tuple
    of such in parentheses, or a nested ``name[...]``.

    Parameters
    ----------
    text : str

    Returns
    -------
    Spec
        Name and parameters; nested specs are `Spec` again.

    Raises
    ------
    InputError
        Quoting the text and saying where it breaks.

    Examples
    --------
    >>> name, params = parse_spec("music2d[detector=osca[pfa=1e-4],integration=element]")
    >>> name, params["integration"], params["detector"].params
    ('music2d', 'element', {'pfa': 0.0001})
    """
    return _SpecParser(text).parse()


def canonical_params(plugin: AnyEstimator | Detector) -> str:
    """Every parameter of an estimator or detector as canonical JSON.

    Returns
    -------
    str
        Sorted keys, no spaces, defaults included; a nested detector is an
        object with its ``name`` beside its parameters. Equal parameters give
        equal strings.
    """
    return json.dumps(_plain_params(plugin), sort_keys=True, separators=(",", ":"), allow_nan=False)


def distribution(kind: Kind, name: str) -> str:
    """Name and version of the package that registers a name, such as ``isacbench 0.1.0``."""
    return _origin(_entry_points(kind)[name])


def describe(kind: Kind) -> list[dict[str, Any]]:
    """Describe every registered estimator or detector.

    Returns
    -------
    list of dict
        ``name``, ``description`` (one line), ``parameters`` (name to ``type``
        and, where there is one, ``default``) and ``package``.
    """
    described = []
    for name, entry_point in sorted(_entry_points(kind).items()):
        plugin = _load(kind, entry_point)
        hints = _parameter_types(kind, plugin)
        described.append(
            {
                "name": name,
                "description": (inspect.getdoc(plugin) or "").partition("\n")[0],
                "parameters": {
                    field.name: _describe_field(field, hints[field.name])
                    for field in dataclasses.fields(plugin)
                },
                "package": _origin(entry_point),
            }
        )
    return described


class _SpecParser:
    """Recursive descent over ``name[param=value,...]``."""

    TOKEN = re.compile(r"\s*([\[\](),=]|[^\[\](),=\s]+)\s*")
    LITERALS: ClassVar[dict[str, bool]] = {"true": True, "false": False}

    def __init__(self, text: str) -> None:
        self.text = text
        self.tokens = self.TOKEN.findall(text)

    def parse(self) -> Spec:
        spec = self.spec(self.word("a name"))
        if self.tokens:
            raise self.broken("the end")
        return spec

    def spec(self, name: str) -> Spec:
        params: dict[str, Any] = {}
        if self.take("["):
            while not self.take("]"):
                key = self.word("a parameter or ']'")
                if key in params:
                    raise InputError(f"{self.text!r}: parameter {key!r} is given twice")
                self.expect("=")
                params[key] = self.value()
                self.separate("]")
        return Spec(name, params)

    def value(self) -> Any:
        if self.take("("):
            items = []
            while not self.take(")"):
                items.append(self.value())
                self.separate(")")
            return tuple(items)
        word = self.word("a value")
        return self.spec(word) if self.tokens[:1] == ["["] else self.scalar(word)

    def scalar(self, word: str) -> bool | int | float | str:
        if word in self.LITERALS:
            return self.LITERALS[word]
        for number in (int, float):
            try:
                return number(word)
            except ValueError:
                continue
        return word

    def word(self, wanted: str) -> str:
        if not self.tokens or self.tokens[0] in "[](),=":
            raise self.broken(wanted)
        return str(self.tokens.pop(0))

    def separate(self, closing: str) -> None:
        if self.tokens[:1] != [closing]:
            self.expect(",", f"',' or {closing!r}")

    def expect(self, token: str, wanted: str = "") -> None:
        if not self.take(token):
            raise self.broken(wanted or repr(token))

    def take(self, token: str) -> bool:
        if self.tokens[:1] != [token]:
            return False
        self.tokens.pop(0)
        return True

    def broken(self, wanted: str) -> InputError:
        where = f"before {''.join(self.tokens)!r}" if self.tokens else "at its end"
        return InputError(f"{self.text!r}: expected {wanted} {where}; allowed is NAME[param=value,...]")


def _entry_points(kind: Kind) -> dict[str, EntryPoint]:
    """Entry points of a group by name; two packages must not claim the same name."""
    found: dict[str, EntryPoint] = {}
    for entry_point in entry_points(group=GROUPS[kind]):
        if entry_point.name in found:
            raise InputError(
                f"{kind} {entry_point.name!r} is registered twice, by {_origin(found[entry_point.name])} and "
                f"by {_origin(entry_point)}: names must be unique, uninstall or rename one"
            )
        found[entry_point.name] = entry_point
    return found


def _origin(entry_point: EntryPoint) -> str:
    """Name the package of an entry point and its version."""
    return f"{entry_point.dist.name} {entry_point.dist.version}" if entry_point.dist else entry_point.value


def _load(kind: Kind, entry_point: EntryPoint) -> type[Any]:
    """Import a plugin's class and hold it to the contract."""
    where = f"{kind} {entry_point.name!r} ({entry_point.value} of {_origin(entry_point)})"
    try:
        plugin = entry_point.load()
    except (ImportError, AttributeError) as error:
        raise InputError(f"{where} cannot be loaded: {type(error).__name__}: {error}") from error
    if not (inspect.isclass(plugin) and dataclasses.is_dataclass(plugin) and _is_frozen(plugin)):
        raise InputError(f"{where} must be a frozen dataclass")
    if not callable(getattr(plugin, METHODS[kind], None)):
        raise InputError(f"{where} must have a method {METHODS[kind]!r}")
    if getattr(plugin, "name", None) != entry_point.name:
        raise InputError(
            f"{where} must have the class attribute name = {entry_point.name!r}, "
            f"not {getattr(plugin, 'name', None)!r}"
        )
    return plugin


def _is_frozen(plugin: type[Any]) -> bool:
    return bool(plugin.__dataclass_params__.frozen)


def _build(kind: Kind, name: str, params: dict[str, Any]) -> Any:
    """Instance of a registered class with checked parameters."""
    registered = _entry_points(kind)
    if name not in registered:
        raise unknown_name(kind, name, sorted(registered))
    plugin = _load(kind, registered[name])
    hints = _parameter_types(kind, plugin)
    for key in params:
        if key not in hints:
            raise unknown_name(f"parameter of {kind} {name}", key, hints)
    checked = {key: _check(f"{kind} {name}", key, value, hints[key]) for key, value in params.items()}
    missing = [field.name for field in _required(plugin) if field.name not in checked]
    if missing:
        raise InputError(f"{kind} {name}: missing parameter {', '.join(missing)}")
    try:
        return plugin(**checked)
    except ValueError as error:
        raise InputError(f"{kind} {name}: {error}") from error


def _required(plugin: type[Any]) -> list[dataclasses.Field[Any]]:
    return [
        field
        for field in dataclasses.fields(plugin)
        if field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
    ]


def _parameter_types(kind: Kind, plugin: type[Any]) -> dict[str, Any]:
    """Types of a plugin's fields; `Detector` resolves even where it is imported for type checking only."""
    try:
        hints = get_type_hints(plugin, localns={"Detector": Detector}, include_extras=True)
    except NameError as error:
        raise InputError(
            f"{kind} {plugin.name}: the type of a parameter cannot be resolved ({error}): "
            "import it at run time, not under TYPE_CHECKING"
        ) from error
    return {field.name: hints[field.name] for field in dataclasses.fields(plugin)}


def _check(where: str, key: str, value: Any, hint: Any) -> Any:
    """Value of a parameter, a nested detector built, held to the type of its field."""
    if Detector in (hint, *get_args(hint)):
        if isinstance(value, str):
            value = Spec(value, {})
        if isinstance(value, Spec):
            return get_detector(value.name, **value.params)
    if value == "none" and type(None) in get_args(hint):
        return None
    config = ConfigDict(strict=True, arbitrary_types_allowed=True, allow_inf_nan=False)
    try:
        return TypeAdapter(hint, config=config).validate_python(value)
    except ValidationError as error:
        # A union reports what each of its members wants.
        wanted = " or ".join(
            dict.fromkeys(found["msg"].removeprefix("Input should be ") for found in error.errors())
        )
        shown = f"{value.name}[...]" if isinstance(value, Spec) else repr(value)
        raise InputError(f"{where}: {key} = {shown}: should be {wanted}") from error


def _plain_params(plugin: Any) -> dict[str, Any]:
    return {field.name: _plain(getattr(plugin, field.name)) for field in dataclasses.fields(plugin)}


def _plain(value: Any) -> Any:
    """Put a parameter's value in terms of JSON."""
    if dataclasses.is_dataclass(value):
        return {"name": getattr(value, "name", type(value).__name__), **_plain_params(value)}
    return [_plain(item) for item in value] if isinstance(value, (list, tuple)) else value


def _describe_field(field: dataclasses.Field[Any], hint: Any) -> dict[str, Any]:
    """Type of a parameter in words, and its default where it has one."""
    described: dict[str, Any] = {"type": inspect.formatannotation(hint, base_module=Detector.__module__)}
    if field.default is not dataclasses.MISSING:
        described["default"] = _plain(field.default)
    elif field.default_factory is not dataclasses.MISSING:
        described["default"] = _plain(field.default_factory())
    return described
