"""Whatever becomes of the standard streams, files are written and the exit code is that of the work."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

NOISE = 'os.write(1, b"from C\\n"); print("from Python"); subprocess.run(["echo", "from a child"])'
LOUD = f"""
import io, os, subprocess, sys
from dataclasses import dataclass
from typing import ClassVar

from isacbench.model.cloud import PointCloud
from isacbench.plugins.contracts import Detection, Needs

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
            **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "check": False, **options},
        )

    return run


def closed_pipe():
    reader, writer = os.pipe()
    os.close(reader)
    return writer


RUN = ("run", "quick", "-s", "tiny.toml", "--snr", 0, "-n", 1, "--plugin", "loud.py", "-o", "out")


def test_a_run_whose_reader_has_left_writes_all_files_and_has_its_own_exit_code(command, tmp_path):
    writer = closed_pipe()
    result = command(*RUN, "-e", "oracle", "-e", "loud[fails=true]", stdout=writer)
    os.close(writer)
    assert result.returncode == 3, result.stderr
    assert {"results.parquet", "summary.md", "report.html"} <= {
        path.name for path in (tmp_path / "out").iterdir()
    }
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


@pytest.mark.parametrize(
    "arguments",
    [
        ("list", "--json", "--plugin", "loud.py"),
        ("plan", "--json", "-e", "loud", "--plugin", "loud.py"),
        ("check", "--json", "loud.py"),
        (
            "stress",
            "--json",
            "-e",
            "loud",
            "--case",
            "spread[n_echoes=2]",
            "--plugin",
            "loud.py",
            "-o",
            "out",
        ),
    ],
    ids=lambda arguments: arguments[0],
)
def test_standard_output_is_the_json_alone_whatever_a_plugin_prints(command, arguments):
    result = command(*arguments)
    assert result.returncode in (0, 3), result.stderr
    assert json.loads(result.stdout)
    assert "from C" in result.stderr


def test_a_run_prints_nothing_of_a_plugin_on_standard_output(command):
    result = command(*RUN, "-e", "loud", "--no-html")
    assert result.returncode == 0, result.stderr
    assert "from " not in result.stdout
    assert "loud" in result.stdout


KEEPING = "OUT = sys.stdout; out = lambda text, file=sys.stderr: print(text, file=file)"


@pytest.mark.parametrize("jobs", [(), ("--jobs", 1)], ids=["in process", "in a worker"])
def test_a_plugin_may_keep_streams_that_it_had_when_it_was_imported(command, write_plugin, jobs):
    using = "print('kept', file=OUT); out('kept, too')"
    write_plugin("loud.py", LOUD.replace(NOISE, KEEPING, 1).replace(NOISE, using))
    result = command(*RUN, "-n", 2, "-e", "loud", "--no-html", *jobs)
    assert result.returncode == 0, result.stderr
    assert "kept" not in result.stdout
    assert {"kept", "kept, too"} <= set(result.stderr.splitlines())


LATER = {
    "atexit": "import atexit; atexit.register(print, 'late')",
    # Nor does it keep the command from ending, though it prints for ever.
    "thread": "import threading, time; threading.Thread(target=lambda: "
    "[(print('late', flush=True), time.sleep(1e-3)) for _ in iter(int, 1)]).start()",
}


@pytest.mark.parametrize("act", LATER)
def test_standard_output_is_the_json_alone_when_a_plugin_prints_later(command, write_plugin, act):
    write_plugin("loud.py", LOUD.replace(NOISE, LATER[act], 1).replace(NOISE, "pass"))
    result = command("list", "--json", "--plugin", "loud.py", timeout=120)
    assert json.loads(result.stdout)
    assert "late" in result.stderr
