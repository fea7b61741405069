"""Whatever becomes of the standard streams, files are written and the exit code is that of the work."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import DRAW_NOTHING

NOISE = (
    'os.write(1, b"from C\\n"); print("from Python"); subprocess.run(["echo", "from a child"]); '
    'print("from a stream", file=OUT); out("from a default")'
)
LOUD = f"""
import atexit, io, os, subprocess, sys, threading, time
from dataclasses import dataclass
from typing import ClassVar

from isacbench.model.cloud import PointCloud
from isacbench.plugins.contracts import Detection, Needs
{DRAW_NOTHING}
OUT = sys.stdout
out = lambda text, file=sys.stderr: print(text, file=file)
{NOISE}

@dataclass(frozen=True)
class Loud:
    name: ClassVar[str] = "loud"
    fails: bool = False

    def __post_init__(self):
        {NOISE}

    @property
    def needs(self):
        {NOISE}
        return Needs()

    def estimate(self, observation):
        {NOISE}
        if self.fails:
            raise ValueError("on purpose")
        return PointCloud.empty()

"""


@pytest.fixture
def command(tiny, tmp_path, write_plugin):
    """Return a function that runs the command line in a process of its own."""
    write_plugin("loud.py", LOUD)

    def run(*arguments, **options):
        return subprocess.run(
            [sys.executable, "-m", "isacbench", *map(str, arguments)],
            cwd=tmp_path,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
            timeout=120,
            **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "check": False, **options},
        )

    return run


RUN = ("run", "quick", "-s", "tiny.toml", "--snr", 0, "-n", 2, "--plugin", "loud.py", "-o", "out")


def test_a_run_whose_reader_has_left_writes_all_files_and_has_its_own_exit_code(command, tmp_path):
    reader, writer = os.pipe()
    os.close(reader)
    result = command(*RUN, "-e", "oracle", "-e", "loud[fails=true]", stdout=writer)
    os.close(writer)
    assert result.returncode == 3, result.stderr
    assert {"results.parquet", "summary.md"} <= {path.name for path in (tmp_path / "out").iterdir()}
    assert "Broken pipe" not in result.stderr


def test_a_full_disk_behind_stdout_is_told(command):
    with Path("/dev/full").open("w") as full:
        result = command("scene", "street", stdout=full)
    assert result.returncode == 0
    assert result.stderr == "isacbench: stdout: No space left on device; the rest is not printed\n"


def test_without_standard_output_the_exit_code_is_the_same(command, tmp_path):
    for scenario, code in (("nothing", 2), ("street", 0)):
        shell = f"{sys.executable} -m isacbench scene {scenario} >&-"
        assert subprocess.run(shell, shell=True, cwd=tmp_path, check=False).returncode == code


# Nor do threads that print for ever keep the command from ending.
THREAD = (
    """threading.Thread(target=lambda: [print("late", flush=True) for _ in iter(time.time, 0)]).start()"""
)
STRESS = "stress -e loud --case spread[n_echoes=2] -o out --plugin loud.py"


@pytest.mark.parametrize(
    ("call", "later"),
    [
        ("plan -e loud --plugin loud.py", THREAD),
        ("check loud.py", "atexit.register(print, 'late')"),
        (STRESS, ""),
    ],
    ids=lambda text: text.partition(" ")[0],
)
def test_standard_output_is_the_json_alone_whatever_a_plugin_prints_and_when(
    command, write_plugin, call, later
):
    write_plugin("loud.py", LOUD + later)
    result = command(*call.split(), "--json")
    assert result.returncode in (0, 3), result.stderr
    assert json.loads(result.stdout)
    assert {"from C", "from a stream", "from a default"} <= set(result.stderr.splitlines())
    assert not later or "late" in result.stderr


def test_a_run_prints_nothing_of_a_plugin_on_standard_output(command):
    result = command(*RUN, "-e", "loud", "--no-html")
    assert result.returncode == 0, result.stderr
    assert "from " not in result.stdout
    assert "loud" in result.stdout
    assert {"from C", "from a stream", "from a default"} <= set(result.stderr.splitlines())
