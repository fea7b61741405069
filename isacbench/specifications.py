"""Specifications: ``name[param=value,...]``, and grids of them where a value is a list of alternatives."""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from typing import Any, NamedTuple

from isacbench.errors import InputError

MAX_VARIANTS = 1000
"""Most variants of a grid; a larger one is most likely a mistake."""


class QuotedText(str):
    """A text that was given in quotes: no number, no truth value and not ``none``."""


class Spec(NamedTuple):
    """A name and its parameters, as ``name[param=value,...]`` spells them."""

    name: str
    params: dict[str, Any]


class SpelledVariant(NamedTuple):
    """One of the specifications that a grid stands for, and its spelling without spaces and alternatives."""

    text: str
    spec: Spec


def parse_spec(text: str) -> Spec:
    """Parse ``name[param=value,...]``.

    A value is an integer, a float, ``true``, ``false``, a bare word, a text in double
    quotes as in JSON, a tuple of such in parentheses, or a nested ``name[...]``. A grid is refused.

    Examples
    --------
    >>> name, params = parse_spec("music2d[detector=osca[pfa=1e-4],integration=element]")
    >>> name, params["integration"], params["detector"].params
    ('music2d', 'element', {'pfa': 0.0001})
    """
    variants = spec_variants(text)
    if len(variants) > 1:
        first = f"{variants[0].text!r}, ..."
        raise InputError(
            f"{text!r} names {len(variants)} variants ({first}); give one value for each parameter"
        )
    return variants[0].spec


def spec_variants(text: str) -> list[SpelledVariant]:
    """Parse a specification in which any value may be a list of alternatives, ``param=[value,...]``.

    Alternatives may stand in nested specifications and in tuples. There is a
    variant for every combination, that of the last parameter varying fastest.

    Examples
    --------
    >>> [variant.text for variant in spec_variants("a[d=[b,c[n=1]],pfa=[1e-3,1e-4]]")]
    ['a[d=b,pfa=1e-3]', 'a[d=b,pfa=1e-4]', 'a[d=c[n=1],pfa=1e-3]', 'a[d=c[n=1],pfa=1e-4]']
    """
    parser = _SpecParser(text)
    options = parser.spec(parser.word("a name"))
    if parser.tokens:
        raise parser.broken("the end")
    return [SpelledVariant(*option) for option in options]


def spell_spec(name: str, params: Mapping[str, Any]) -> str:
    """Spell a name and parameters, in terms of JSON as a run has them, as `parse_spec` reads them.

    Examples
    --------
    >>> spell_spec("a", {"detector": {"guard": [0, 3], "name": "ca"}, "pfa": None, "on": True})
    'a[detector=ca[guard=(0,3)],pfa=none,on=true]'
    """
    values = ",".join(f"{key}={spell_value(value)}" for key, value in params.items())
    return f"{name}[{values}]" if values else name


def spell_value(value: Any) -> str:
    """Spell the value of a parameter, as `spell_spec` does.

    Examples
    --------
    >>> spell_value(1e-5), spell_value([True, None]), spell_value(["near", "far away", "3"])
    ('1e-05', '(true,none)', '(near,"far away","3")')
    """
    if value is None:
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return f"({','.join(map(spell_value, value))})"
    if isinstance(value, dict) and "name" in value:
        params = dict(value)
        return spell_spec(str(params.pop("name")), params)
    if isinstance(value, str) and not is_word(value):
        return json.dumps(value, ensure_ascii=False)
    return str(value)


def is_word(text: str) -> bool:
    """Tell whether a specification can hold a text as it is, as a name or a value, without quotes.

    Examples
    --------
    >>> [is_word(text) for text in ("near", "far away", "3", "none", "")]
    [True, False, False, False, False]
    """
    parser = _SpecParser(text)
    is_one = parser.tokens == [text] and '"' not in text and text not in "[](),=" and text.isprintable()
    return is_one and parser.scalar(text) == text != "none"


def is_number(text: str) -> bool:
    """Tell if a text is a number, NaN and infinity included; not ``1_0`` and ``１``, which `float` takes."""
    try:
        float(text)
    except ValueError:
        return False
    return text.isascii() and "_" not in text


_Option = tuple[str, Any]
"""Spelling of one of the values that a part of a specification stands for, and the value."""


class _SpecParser:
    """Recursive descent over ``name[param=value,...]``; every part yields its options."""

    TOKEN = re.compile(r'\s*([\[\](),=]|"(?:[^"\\]|\\.)*"|[^\[\](),=\s]+)\s*')

    def __init__(self, text: str) -> None:
        self.text = text
        self.tokens: list[str] = self.TOKEN.findall(text)

    def spec(self, name: str) -> list[_Option]:
        """Options of a name whose parameters may follow."""
        if not self.take("["):
            return [(name, Spec(name, {}))]
        params: dict[str, list[_Option]] = {}
        for _ in self.items("]"):
            key = self.word("a parameter or ']'")
            if key in params:
                raise InputError(f"{self.text!r}: parameter {key!r} is given twice")
            self.expect("=", "'='")
            params[key] = self.alternatives(key) if self.take("[") else self.single(key)
        options = []
        for chosen in self.combinations(params.values()):
            named = dict(zip(params, chosen, strict=True))
            text = ",".join(f"{key}={spelling}" for key, (spelling, _) in named.items())
            options.append((f"{name}[{text}]", Spec(name, {key: value for key, (_, value) in named.items()})))
        return options

    def alternatives(self, key: str) -> list[_Option]:
        """Options of a list of alternatives whose bracket is already taken."""
        # By what they mean, not by how they are spelled; 1 and 1.0 are not the same everywhere.
        options: dict[str, _Option] = {}
        for _ in self.items("]"):
            for text, value in self.single(key):
                if repr(value) in options:
                    raise InputError(f"{self.text!r}: {key!r} lists the alternative {text} twice")
                options[repr(value)] = text, value
        if not options:
            raise self.broken(f"an alternative for {key!r}")
        return [*options.values()]

    def single(self, key: str) -> list[_Option]:
        """Options of a tuple, a nested specification or a plain value."""
        if self.take("("):
            items = [self.alternatives(key) if self.take("[") else self.single(key) for _ in self.items(")")]
            return [
                (f"({','.join(text for text, _ in chosen)})", tuple(value for _, value in chosen))
                for chosen in self.combinations(items)
            ]
        word = self.word("a value", or_text=True)
        return self.spec(word) if self.tokens[:1] == ["["] else [(word, self.scalar(word))]

    def items(self, closing: str) -> Iterator[None]:
        """Stop before every item of a list whose opening bracket is already taken."""
        while not self.take(closing):
            yield
            if self.tokens[:1] != [closing]:
                self.expect(",", f"',' or {closing!r}")

    def combinations(self, parts: Collection[list[_Option]]) -> Iterator[tuple[_Option, ...]]:
        """Every choice of an option for each part."""
        n = math.prod(map(len, parts))
        if n > MAX_VARIANTS:
            raise InputError(f"{self.text!r}: {n} variants; allowed are at most {MAX_VARIANTS}")
        return itertools.product(*parts)

    def scalar(self, word: str) -> bool | int | float | str:
        if word.startswith('"'):
            try:
                return QuotedText(json.loads(word))
            except ValueError:
                raise InputError(f"{self.text!r}: {word} is no text as JSON has it") from None
        if word in ("true", "false"):
            return word == "true"
        if not is_number(word):
            return word
        with suppress(ValueError):
            return int(word)
        return float(word)

    def word(self, expected: str, or_text: bool = False) -> str:
        if not self.tokens or self.tokens[0] in "[](),=" or (self.tokens[0][0] == '"' and not or_text):
            raise self.broken(expected)
        return self.tokens.pop(0)

    def expect(self, token: str, expected: str) -> None:
        if not self.take(token):
            raise self.broken(expected)

    def take(self, token: str) -> bool:
        is_next = self.tokens[:1] == [token]
        del self.tokens[: int(is_next)]
        return is_next

    def broken(self, expected: str) -> InputError:
        where = f"before {''.join(self.tokens)!r}" if self.tokens else "at its end"
        return InputError(f"{self.text!r}: expected {expected} {where}; allowed is NAME[param=value,...]")
