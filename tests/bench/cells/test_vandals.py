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
    "none": "sys.stdout = sys.stderr = None",
    "backend": "scipy.fft.set_global_backend(Zero)",
}
ALONE = {  # what is not undone: the others have a process of their own
    "close": "sys.stdout.close(); sys.stderr.close()",
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
import os, resource, signal, subprocess, sys, threading, time
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
    act: str = "pass"

    def estimate(self, observation):
        exec(ACTS.get(self.act, "pass"))
        return PointCloud(np.zeros((1, 3)), [0.0], [1.0])
"""
WITNESS = """
@dataclass(frozen=True)
class Witness:
    name: ClassVar[str] = "witness"
    after: str = "nothing"

    def estimate(self, observation):
        for stream in (sys.stdout, sys.stderr):
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
def reports(tiny, write_plugin):
    """Return a function that gives what a witness reports after each of some acts, and before all of them."""
    witness = write_plugin("witness.py", HEAD + WITNESS)

    def run_all(acts, jobs, at_import="pass"):
        vandal = write_plugin("vandal.py", f"{HEAD}{at_import}\nACTS = {acts!r}\n{VANDAL}")
        each = [text for act in acts for text in (f"vandal[act={act}]", f"witness[after={act}]")]
        suite = Suite(name="t", scenarios=[str(tiny)], estimators=["oracle"], snr_db=[0, 5], trials=1)
        rows = run(suite, estimators=["witness", *each], plugins=[vandal, witness], jobs=jobs)
        assert (rows["status"][rows["estimator"] == "vandal"] == "ok").all(), rows["reason"].tolist()
        found = rows[rows["estimator"] == "witness"]
        return dict(zip(found["params"] + found["snr_db"].astype(str), found["reason"], strict=True))

    return run_all


def assert_equal(found):
    (first, *_) = found.values()
    assert [key for key, report in found.items() if report != first] == []


ignoring_own_files = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")


@ignoring_own_files
def test_what_plugins_change_in_the_caller_s_process_is_undone(reports):
    assert_equal(reports(ACTS, None))


@ignoring_own_files
@pytest.mark.parametrize("act", sorted({*ACTS} - {"zone"}))  # a plugin may set the environment for later
def test_what_the_import_of_a_plugin_changes_is_undone(reports, act):
    found = reports({}, None)
    assert_equal({**found, **{f"{key} {act}": one for key, one in reports({}, None, ACTS[act]).items()}})


def test_no_plugin_meets_the_process_that_another_has_changed(reports):
    undisturbed = reports({}, 1)
    acts = {**ALONE, **ACTS, "constant": "np.pi = 3.0"}
    assert_equal({**undisturbed, **reports({"everything": "; ".join(acts.values())}, 1)})


def test_what_a_plugin_has_left_running_stands_still_while_others_work(tiny, write_plugin, tmp_path):
    stamps = tmp_path / "stamps"
    busy = f"subprocess.Popen(['sh', '-c', 'while :; do date +%s.%N >> {stamps}; sleep 0.01; done'])"
    path = str(stamps)
    begin = f"{busy}\nwhile not os.path.exists({path!r}) or not os.path.getsize({path!r}): pass"
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
        write_plugin("vandal.py", f"{HEAD}ACTS = {{'pass': {begin!r}}}\n{VANDAL}"),
        write_plugin("witness.py", HEAD + plain),
    ]
    suite = Suite(name="t", scenarios=[str(tiny)], estimators=["oracle"], snr_db=[0], trials=1)
    rows = run(suite, estimators=["vandal", "witness"], plugins=files, jobs=1)
    assert rows["reason"].tolist() == ["", "RuntimeError: 0 written, True (witness.py, line 27, in estimate)"]
    size = stamps.stat().st_size
    time.sleep(0.2)
    assert stamps.stat().st_size == size  # it ended with the run
