"""Commands end in exit code 2 and one line about hostile files, whoever names them."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

from isacbench.cli import app

from .files import ANY, CLOUDS, CUBES, TOML

ESCAPES = ("\x1b", "\x07", "\x9b", "\u202e")


@pytest.fixture
def told(bounded):
    """Return a function that runs a command that must refuse, and returns its line."""

    def run(*arguments):
        with bounded():
            result = CliRunner().invoke(app, list(map(str, arguments)))
        assert result.exit_code == 2, result.output
        assert isinstance(result.exception, SystemExit)
        assert result.stderr.startswith("isacbench: ")
        assert result.stderr.count("\n") == 1
        assert not any(sign in result.stderr for sign in ESCAPES)
        return result.stderr

    return run


COMMANDS = {
    ".csv": ["score FILE FILE", "score street FILE"],
    ".mat": ["score street FILE", "image --cube FILE"],
    ".npy": ["image --cube FILE", "image --cube FILE --plot a.png"],
    ".npz": ["score street FILE", "image --cube FILE"],
    ".ply": ["score street FILE"],
    ".h5": ["image --cube FILE"],
    ".zarr": ["image --cube FILE"],
    ".toml": [
        *("run FILE -o OUT", "run quick -s FILE -o OUT", "image -s FILE", "simulate -s FILE -o OUT.npy"),
        *("plan -s FILE", "score FILE FILE"),
    ],
    ".py": ["check FILE", "list --plugin FILE", "image --plugin FILE", "run quick --plugin FILE -o OUT"],
}
"""Commands that read a file, by its extension."""


HOSTILE = {
    ".csv": CLOUDS[".csv"]["100 000 columns"],
    ".mat": CLOUDS[".mat"]["cells"],
    ".npy": CLOUDS[".npy"]["Python objects"],
    ".npz": CLOUDS[".npz"]["pickled"],
    ".ply": CLOUDS[".ply"]["1e18, ascii"],
    ".h5": CUBES[".h5"]["1e18 cells"],
    ".zarr": ANY["a folder"],
    ".toml": TOML["arrays in arrays"],
    ".py": ANY["a terabyte"],
}


@pytest.mark.parametrize("suffix", HOSTILE)
def test_every_command_that_reads_a_file_refuses_a_hostile_one(tmp_path, told, suffix):
    path = tmp_path / f"a\x1b[31m\u202e{{red}}[red]\n{suffix}"
    HOSTILE[suffix](path)
    before = sorted(tmp_path.rglob("*"))
    for command in COMMANDS[suffix]:
        words = (word.replace("OUT", str(tmp_path / "out")) for word in command.split())
        assert "red" in told(*(path if word == "FILE" else word for word in words))
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("suffix", [".csv", ".npy", ".npz", ".mat", ".ply"])
def test_a_name_that_the_system_refuses_is_told_in_its_words(tiny, tmp_path, told, suffix):
    place = tmp_path / f"{'x' * 300}{suffix}"
    assert "File name too long" in told("image", "-s", tiny, "-e", "fft4d", "-o", place)


@pytest.mark.usefixtures("written_empty")
def test_a_run_shows_names_as_they_are(tiny, tmp_path, bounded):
    name = "=1+1 [red]\x1b[31m\n<script>|`$x$\\ ../.."
    tiny.write_text(tiny.read_text().replace('name = "tiny"', f"name = {json.dumps(name)}"), encoding="utf-8")
    out = tmp_path / "out"
    with bounded():
        result = CliRunner().invoke(
            app, ["run", "quick", "-s", str(tiny), "-e", "oracle", "-n", "2", "--snr", "0", "-o", str(out)]
        )
    assert result.exit_code == 0, result.output
    assert not any(sign in result.output for sign in ESCAPES)
    assert "[red]" in result.stdout
    assert "<script>" not in (out / "summary.md").read_text()
    for table in ("results.csv", "summary.csv"):
        assert "'=1+1" in (out / table).read_text()
    figures = {path.name for path in (out / "figures").iterdir()}
    assert all(path.replace("-", "").replace(".png", "").isalnum() for path in figures)
    assert json.loads((out / "manifest.json").read_text())["scenarios"].keys() == {name}


def test_a_bar_takes_no_name_for_markup(monkeypatch, capsys):
    from isacbench.bench.run.progress import progress_shown

    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    with progress_shown("[/] [red]x\x1b]0;title\x07") as show:
        show(1, 2)
    assert "\x1b]0;" not in capsys.readouterr().err
