"""The server of worker processes."""

import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from isacbench.bench.cells import process

BARE_SERVER = """
from isacbench.bench.cells import process
from isacbench.bench.cells.process import GuardedProcess

process._preloaded = list
"""
"""Beginning of a script whose server imports nothing, which takes most of its time."""

SCRIPT = f"""{BARE_SERVER}
import os

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


CALLERS = f"""{BARE_SERVER}
import asyncio, multiprocessing, os, signal, sys, threading
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import spawn

def work(number):
    with GuardedProcess(os.getpid) as process:
        return process.call(abs, number)

def handlers(_):
    return signal.pthread_sigmask(signal.SIG_BLOCK, [])

async def both():
    return await asyncio.gather(*(asyncio.to_thread(work, number) for number in (-5, -6)))

if __name__ == "__main__":
    print(work(-1), flush=True)
    fork = multiprocessing.get_context("fork")
    CALL
"""


@pytest.mark.parametrize(
    ("call", "printed"),
    [
        ("print(fork.Pool(1).map(work, [-2]))", "[2]"),
        ("print(list(ProcessPoolExecutor(1, fork).map(work, [-3, -4])))", "[3, 4]"),
        ("print(asyncio.run(both()))", "[5, 6]"),
        ("if os.fork():\n    os.wait()\nelse:\n    print(work(-7), flush=True)\n    os._exit(0)", "7"),
        ("vars(spawn)['get_start_method'] = lambda: 'loky'\nprint(work(-8))", "8"),
        ("print(multiprocessing.get_context('forkserver').Pool(1).map(handlers, [0]))", "[set()]"),
    ],
    ids=["pool", "executor", "asyncio", "fork", "loky", "forkserver of the caller"],
)
def test_workers_start_from_whatever_process_calls_and_leave_the_caller_s_own_alone(tmp_path, call, printed):
    script = tmp_path / "script.py"
    script.write_text(CALLERS.replace("CALL", call.replace("\n", "\n    ")))
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False, timeout=120)
    assert (done.stdout, done.stderr) == (f"1\n{printed}\n", "")


def test_threads_that_start_the_server_at_the_same_time_leave_the_environment_as_it_was(monkeypatch):
    before = dict(os.environ)
    monkeypatch.setattr(process._server, "ensure_running", lambda: time.sleep(0.1))
    with ThreadPoolExecutor(4) as threads:
        started = [threads.submit(process.start_process_server) for _ in range(4)]
    assert [one.result() is not None for one in started] == [True] * 4
    assert dict(os.environ) == before
