import os
import signal
import time
from concurrent.futures import CancelledError
from threading import Timer

import pytest

from isacbench.bench.cells.process import GuardedProcess, ProcessLostError


@pytest.fixture(scope="module")
def process():
    with GuardedProcess(os.getpid) as guarded:
        yield guarded


def test_a_call_is_answered_by_another_process_the_same_every_time(process):
    first = process.call(os.getpid)
    assert first == process.call(os.getpid) != os.getpid()


def test_what_a_function_raises_is_raised_here_and_costs_no_process(process):
    before = process.call(os.getpid)
    with pytest.raises(ValueError, match="invalid literal"):
        process.call(int, "x")
    assert process.call(os.getpid) == before


@pytest.mark.parametrize(
    ("function", "args", "reason"),
    [
        (os._exit, (0,), "the process exited with code 0"),
        (os._exit, (7,), "the process exited with code 7"),
        (signal.raise_signal, (signal.SIGKILL,), "the process died by SIGKILL"),
        (signal.raise_signal, (signal.SIGSEGV,), "the process died by SIGSEGV"),
    ],
)
def test_a_process_that_is_lost_is_told_and_replaced(process, function, args, reason):
    before = process.call(os.getpid)
    with pytest.raises(ProcessLostError, match=reason) as lost:
        process.call(function, *args)
    assert lost.value.status == "killed"
    assert process.call(os.getpid) != before


def test_a_deadline_ends_the_process(process):
    with pytest.raises(ProcessLostError, match=r"more than 0\.5 s") as lost:
        process.call(time.sleep, 600, timeout_s=0.5)
    assert lost.value.status == "timeout"
    assert process.call(abs, -1) == 1


def test_a_deadline_does_not_count_the_time_in_which_a_process_begins():
    with GuardedProcess(time.sleep, 1.5) as guarded:
        assert guarded.call(abs, -1, timeout_s=1.0) == 1


def test_a_fresh_process_begins_as_the_first_one_did():
    with GuardedProcess(os.putenv, "BEGUN", "1") as guarded:
        for _ in range(2):
            assert guarded.call(os.system, 'test "$BEGUN" = 1') == 0
            guarded.renew()


def test_a_process_that_dies_first_when_a_whole_job_is_terminated_is_not_told_as_lost():
    with GuardedProcess(os.getpid) as guarded:
        guarded.call(os.getpid)
        Timer(1.0, guarded.stop).start()
        with pytest.raises(CancelledError):
            guarded.call(signal.raise_signal, signal.SIGTERM)


def test_a_process_that_is_stopped_ends_at_once_and_answers_nobody():
    guarded = GuardedProcess(os.getpid)
    process_id = guarded.call(os.getpid)
    Timer(0.3, guarded.stop).start()
    with pytest.raises(CancelledError):
        guarded.call(time.sleep, 600)
    guarded.stop()
    with pytest.raises(ProcessLookupError):
        os.kill(process_id, 0)
    with pytest.raises(CancelledError):
        guarded.call(abs, -1)


def test_what_terminates_a_whole_job_leaves_a_server_that_starts_the_processes_of_the_report():
    servers = set()
    for _ in range(2):
        with GuardedProcess(os.getpid) as guarded:
            servers.add(guarded.call(os.getppid))
        for server in servers:
            os.kill(server, signal.SIGTERM)
    assert len(servers) == 1
