"""Parameters of every type: either a command takes what `list` prints, or all commands refuse them alike."""

import json
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from isacbench.cli import app
from isacbench.errors import InputWarning
from isacbench.plugins.discovery import isolated_plugins, load_plugin_file
from isacbench.plugins.registry import build_estimator, canonical_params, describe_plugin, get_estimator
from isacbench.specifications import parse_spec, spell_spec, spell_value

PLUGIN = """
import enum
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from isacbench.model.cloud import PointCloud
from isacbench.plugins.contracts import Detector
from isacbench.plugins.registry import get_detector

class Mode(str, enum.Enum):
    SLOW = "slow"

class Level(enum.IntEnum):
    LOW = 1

@dataclass(frozen=True)
class Window:
    name: ClassVar[str] = "window"
    size: int = 3

@dataclass(frozen=True)
class Typed:
    "Without this, Python 3.11.2 writes a docstring with the default, and fails where it is too long."
    name: ClassVar[str] = "typed"
    value: HINT = VALUE

    def estimate(self, observation):
        return PointCloud.empty()
"""

WORKS = [
    ("int", "3"),
    ("int", "np.int64(3)"),
    ("float", "-1e-300"),
    ("float", "1"),
    ("float | None", "1"),
    ("float", "np.float32(0.1)"),
    ("float | None", "None"),
    ("bool", "np.bool_(True)"),
    ("str", "'near'"),
    ("str", "''"),
    ("str", "'far away'"),
    ("str", "'3'"),
    ("str", "'1e5'"),
    ("str", "'true'"),
    ("str", "'none'"),
    ("str | None", "'none'"),
    ("str | None", "None"),
    ("str", "'a[b=(1,2)]'"),
    ("str", "'\"'"),
    ("str", "'two\\nlines'"),
    ("str", "'größe'"),
    ("str", "np.str_('word')"),
    ("Literal['deep', 'two words']", "'two words'"),
    ("tuple[int, ...]", "()"),
    ("tuple[float, ...]", "(1.0, 2.5)"),
    ("tuple[tuple[int, str | None], ...]", "((1, 'a b'), (2, None))"),
    ("Detector", "field(default_factory=lambda: get_detector('os', pfa=1e-4))"),
    ("Detector | None", "None"),
    ("tuple[Detector, ...]", "field(default_factory=lambda: (get_detector('os'), get_detector('ca')))"),
    ("Any", "'3'"),
    ("int", "10**1000"),
]

REFUSED = [
    ("Path", "Path('here')"),
    ("float", "float('inf')"),
    ("float", "float('nan')"),
    ("tuple[float, ...]", "(1.0, float('-inf'))"),
    ("complex", "1j"),
    ("Mode", "Mode.SLOW"),
    ("Level", "Level.LOW"),
    ("Any", "lambda x: x"),
    ("Any", "field(default_factory=lambda: np.zeros((3, 40)))"),
    ("dict[str, int]", "field(default_factory=lambda: {'a': 1})"),
    ("list[int]", "field(default_factory=lambda: [1])"),
    ("Any", "frozenset({1})"),
    ("bytes", "b'a'"),
    ("Window", "Window()"),
    ("Detector", "Window()"),
    ("int", "2.5"),
    ("int", "field(default_factory=lambda: 1 // 0)"),
]


@pytest.fixture
def typed(write_plugin):
    """Return a function that registers an estimator whose parameter has a type and a default."""

    def register(hint, value):
        path = write_plugin("typed.py", PLUGIN.replace("HINT", hint).replace("VALUE", value))
        load_plugin_file(path)
        return path

    return register


@pytest.mark.parametrize(("hint", "value"), WORKS)
def test_what_list_prints_of_a_parameter_builds_the_same_estimator(typed, hint, value):
    typed(hint, value)
    (described,) = [one for one in describe_plugin("estimator") if one["name"] == "typed"]
    spelled = spell_value(described["parameters"]["value"]["default"])
    built, default = build_estimator(f"typed[value={spelled}]"), get_estimator("typed")
    assert canonical_params(built) == canonical_params(default)
    assert built.value == default.value
    assert type(built.value) is type(default.value) or isinstance(default.value, str)


ARGUMENTS = {
    "list": ["list", "--plugin", "typed.py"],
    **{
        command: [command, "--plugin", "typed.py", "-e", "typed"]
        for command in ("run", "image", "plan", "stress")
    },
}


@pytest.mark.parametrize(("hint", "value"), REFUSED)
def test_what_a_command_cannot_spell_all_commands_refuse_in_one_line(
    write_plugin, tmp_path, monkeypatch, hint, value
):
    monkeypatch.chdir(tmp_path)
    write_plugin("typed.py", PLUGIN.replace("HINT", hint).replace("VALUE", value))
    lines = set()
    for command, arguments in ARGUMENTS.items():
        with isolated_plugins():
            result = CliRunner().invoke(app, arguments)
        assert result.exit_code == 2, (command, result.output)
        assert not result.stdout, command
        lines.add(re.sub(" at 0x[0-9a-f]+", "", result.stderr))
    (line,) = lines
    assert line.startswith("isacbench: estimator typed")
    assert line.count("\n") == 1
    assert not list(tmp_path.glob("results/*"))
    with isolated_plugins():
        result = CliRunner().invoke(app, ["check", "typed.py", "--json"])
    assert result.exit_code == 3, result.output
    (report,) = json.loads(result.stdout)["plugins"]
    failed = [one["message"] for one in report["findings"] if one["status"] == "failed"]
    told = line.rstrip("\n").partition("typed: ")[2] or "ZeroDivisionError"
    assert any(told in re.sub(" at 0x[0-9a-f]+", "", message) for message in failed), failed


def test_one_broken_package_does_not_empty_the_list(plugin_folder):
    broken = PLUGIN.replace("HINT", "Path").replace("VALUE", "Path('here')")
    plugin_folder.install("broken-plugins", broken, estimators={"typed": "Typed"})
    plugin_folder.install("missing-plugins", "import nowhere_to_be_found", estimators={"lost": "Lost"})
    plugin_folder.install("ending-plugins", "raise SystemExit(4)", estimators={"ended": "Ended"})
    with pytest.warns(InputWarning, match=r"value = PosixPath|nowhere_to_be_found|SystemExit: 4") as told:
        names = [one["name"] for one in describe_plugin("estimator")]
    assert len(told) == 3
    assert "music2d" in names
    assert not {"typed", "lost", "ended"} & {*names}


@pytest.mark.parametrize("name", ["two words", "a[b]", "3", "true", "none", 'a"b', ""])
def test_a_name_that_no_command_can_spell_is_refused(write_plugin, name):
    source = PLUGIN.replace("HINT", "int").replace("VALUE", "1")
    load_plugin_file(write_plugin("typed.py", source.replace('"typed"', repr(name))))
    with pytest.raises(ValueError, match="is no word"):
        describe_plugin("estimator")


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3),
    max_leaves=6,
)


@given(values)
def test_every_value_is_spelled_so_that_it_is_read_as_it_was(value):
    def stored(read):
        if isinstance(read, tuple):
            return [stored(one) for one in read]
        return None if read == "none" and type(read) is str else read

    assert repr(stored(parse_spec(spell_spec("a", {"x": value})).params["x"])) == repr(value)
