"""What one plugin does to its process, no other plugin meets: in workers and in the caller's process."""

import time

import pytest

from isacbench.bench.run.runner import run
from isacbench.bench.suites.suite import Suite

ACTS = {
    "folder": "os.chdir('/')",
    "zone": "os.environ['TZ'] = 'Asia/Tokyo'; time.tzset()",
    "threads": "import threadpoolctl; threadpoolctl.threadpool_limits(2)",
    "errors": "np.seterr(all='raise')",
    "close": "sys.stdout.close(); sys.stderr.close()",
    "wrap": "io.TextIOWrapper(sys.stdout.buffer); gc.collect()",
    "none": "sys.stdout = sys.stderr = None",
    "original": "sys.__stdout__.close(); sys.__stderr__.close()",
    "descriptors": "os.close(1); os.close(2)",
    "backend": "scipy.fft.set_global_backend(Zero)",
}
ALONE = {  # what is not undone: the others have a process of their own
    "limits": "kind = resource.RLIMIT_NOFILE; resource.setrlimit(kind, (200, resource.getrlimit(kind)[1]))",
    "cores": "os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})",
    "library": "np.linalg.svd = scipy.fft.fft = len",
    "method": "PointCloud.to_dataframe = None",
    "signals": "signal.signal(signal.SIGUSR1, signal.SIG_IGN)",
    "nice": "os.nice(5)",
    "thread": "threading.Thread(target=lambda: time.sleep(60), daemon=True, name='left').start()",
    "child": "subprocess.Popen(['sleep', '60'])",
}
HEAD = """
import gc, io, os, resource, signal, subprocess, sys, threading, time
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.fft
from threadpoolctl import threadpool_info

from isacbench.model.cloud import PointCloud

class Zero:
    __ua_domain__ = "numpy.scipy.fft"
    __ua_function__ = staticmethod(lambda *_: 0)

"""
VANDAL = """
@dataclass(frozen=True)
class Vandal:
    name: ClassVar[str] = "vandal"

    def estimate(self, observation):
        ACT
        return PointCloud(np.zeros((1, 3)), [0.0], [1.0])
"""
WITNESS = """
@dataclass(frozen=True)
class Witness:
    name: ClassVar[str] = "witness"

    def estimate(self, observation):
        for stream in (sys.stdout, sys.stderr, sys.__stdout__, sys.__stderr__):
            stream.write("")
            stream.flush()
        os.fstat(1), os.fstat(2)
        parts = [
            os.getcwd(), os.environ.get("TZ"), time.tzname, np.geterr(),
            [one["num_threads"] for one in threadpool_info()], resource.getrlimit(resource.RLIMIT_NOFILE),
            os.sched_getaffinity(0), np.linalg.svd.__name__, scipy.fft.fft.__name__, np.pi,
            PointCloud.to_dataframe is None, signal.getsignal(signal.SIGUSR1), scipy.fft.fft([1.0, 1.0]),
            os.getpriority(os.PRIO_PROCESS, 0),
            [one.name for one in threading.enumerate() if one.name == "left"],
            subprocess.run(["pgrep", "-P", str(os.getpid()), "sleep"], capture_output=True).stdout,
        ]
        raise RuntimeError(repr(parts))
"""


@pytest.fixture
def reason_beside(tiny, write_plugin):
    """Return a function that gives what the witness reports, beside a vandal."""
    witness = write_plugin("witness.py", HEAD + WITNESS)

    def run_both(act, jobs, at_import=False):
        source = HEAD + (
            act + "\n" + VANDAL.replace("ACT", "pass") if at_import else VANDAL.replace("ACT", act)
        )
        names = ["vandal", "witness"]
        suite = Suite(name="t", scenarios=[str(tiny)], estimators=["oracle"], snr_db=[0, 5], trials=1)
        rows = run(suite, estimators=names, plugins=[write_plugin("vandal.py", source), witness], jobs=jobs)
        assert (rows["status"][rows["estimator"] == "vandal"] == "ok").all(), rows["reason"].tolist()
        return set(rows["reason"][rows["estimator"] == "witness"])

    return run_both


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # of the vandal's own files
@pytest.mark.parametrize("at_import", [False, True], ids=["in estimate", "at import"])
@pytest.mark.parametrize("act", ACTS)
def test_what_a_plugin_changes_in_the_caller_s_process_is_undone(reason_beside, act, at_import):
    if at_import and act == "zone":
        pytest.skip("a plugin may set the environment when it is imported")
    (undisturbed,) = reason_beside("pass", None)
    assert reason_beside(ACTS[act], None, at_import) == {undisturbed}


def test_no_plugin_meets_the_process_that_another_has_changed(reason_beside):
    (undisturbed,) = reason_beside("pass", 1)
    acts = {**ALONE, **ACTS, "constant": "np.pi = 3.0"}
    everything = "; ".join(act for name, act in acts.items() if name != "wrap")
    assert reason_beside(everything, 1) == {undisturbed}


def test_what_a_plugin_has_left_running_stands_still_while_others_work(tiny, write_plugin, tmp_path):
    stamps = tmp_path / "stamps"
    busy = f"subprocess.Popen(['sh', '-c', 'while :; do date +%s.%N >> {stamps}; sleep 0.01; done'])"
    path = str(stamps)
    until_written = f"while not os.path.exists({path!r}) or not os.path.getsize({path!r}): pass"
    plain = (
        WITNESS.split("        for stream")[0]
        + f"""
        before = open({path!r}).read()
        time.sleep(0.5)
        after = open({path!r}).read()
        raise RuntimeError(f"{{len(after) - len(before)}} written, {{len(before) > 0}}")
"""
    )
    files = [
        write_plugin("vandal.py", HEAD + VANDAL.replace("ACT", f"{busy}\n        {until_written}")),
        write_plugin("witness.py", HEAD + plain),
    ]
    suite = Suite(name="t", scenarios=[str(tiny)], estimators=["oracle"], snr_db=[0], trials=1)
    rows = run(suite, estimators=["vandal", "witness"], plugins=files, jobs=1)
    assert rows["reason"].tolist() == ["", "RuntimeError: 0 written, True (witness.py, line 26, in estimate)"]
    size = stamps.stat().st_size
    time.sleep(0.2)
    assert stamps.stat().st_size == size  # it ended with the run
