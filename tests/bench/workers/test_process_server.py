"""The server of worker processes."""

import subprocess
import sys

SCRIPT = """
import os
from isacbench.bench.workers.guarded_process import GuardedProcess

before = __spec__, __file__
with GuardedProcess(os.getpid) as process:
    print(process.call(abs, -7))
assert (__spec__, __file__) == before
"""


def test_a_script_that_no_file_holds_and_that_no_line_guards_has_workers():
    done = subprocess.run(
        [sys.executable, "-"], input=SCRIPT, capture_output=True, text=True, check=True, timeout=120
    )
    assert done.stdout == "7\n"


def test_another_isacbench_in_the_working_folder_is_not_imported(tmp_path):
    script, elsewhere = tmp_path / "scripts" / "own.py", tmp_path / "work"
    script.parent.mkdir()
    (elsewhere / "isacbench").mkdir(parents=True)
    (elsewhere / "isacbench" / "__init__.py").write_text("raise SystemExit(9)")
    script.write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, script], cwd=elsewhere, capture_output=True, text=True, check=True, timeout=120
    )
    assert done.stdout == "7\n"
    assert done.stderr == ""
