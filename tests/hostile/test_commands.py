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


def commands(path):
    """Commands that read a file of an extension, by name."""
    return {
        ".csv": {"score": ("score", path, path), "truth": ("score", "street", path)},
        ".mat": {"score": ("score", "street", path), "image": ("image", "--cube", path)},
        ".npy": {"image": ("image", "--cube", path), "plot": ("image", "--cube", path, "--plot", "a.png")},
        ".npz": {"score": ("score", "street", path), "image": ("image", "--cube", path)},
        ".ply": {"score": ("score", "street", path)},
        ".h5": {"image": ("image", "--cube", path)},
        ".zarr": {"image": ("image", "--cube", path)},
        ".toml": {
            "run": ("run", path, "-o", path.with_name("out")),
            "scenario": ("run", "quick", "-s", path, "-o", path.with_name("out")),
            "image": ("image", "-s", path),
            "simulate": ("simulate", "-s", path, "-o", path.with_name("frame.npy")),
            "plan": ("plan", "-s", path),
            "score": ("score", path, path),
        },
        ".py": {
            "check": ("check", path),
            "list": ("list", "--plugin", path),
            "image": ("image", "--plugin", path),
            "run": ("run", "quick", "--plugin", path, "-o", path.with_name("out")),
        },
    }[path.suffix]


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
    for arguments in commands(path).values():
        assert "red" in told(*arguments)
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
