"""What one plugin does to its process, no other plugin meets: in workers and in the caller's process."""

import time

import pytest

from isacbench.bench.run.runner import run
from isacbench.bench.suites.suite import Suite

ACTS = {
    "garbage": "gc.disable(); gc.set_threshold(7)",
    "mask": "os.umask(0)",
    "limits": "kind = resource.RLIMIT_NOFILE; resource.setrlimit(kind, (200, resource.getrlimit(kind)[1]))",
    "zone": "os.environ['TZ'] = 'Asia/Tokyo'; time.tzset()",
    "cores": "os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})",
    "threads": "import threadpoolctl; threadpoolctl.threadpool_limits(2)",
    "errors": "np.seterr(all='raise')",
    "switch": "sys.setswitchinterval(0.5)",
    "decimal": "decimal.getcontext().prec = 3",
    "locale": "locale.setlocale(locale.LC_ALL, 'C')",
    "library": "np.linalg.svd = scipy.fft.fft = len",
    "method": "PointCloud.to_dataframe = None",
    "signals": "signal.pthread_sigmask(signal.SIG_BLOCK, range(1, 32))",
    "modules": "sys.modules['pandas'] = None; sys.meta_path.clear()",
    "logs": "logging.disable(50)",
    "trace": "sys.settrace(lambda *_: None)",
    "threads' trace": "threading.settrace(len); threading.setprofile(len)",
    "arguments": "sys.argv[:] = ['other']",
    "root logger": "logging.root.setLevel(1); logging.root.addHandler(logging.NullHandler())",
    "backend": "scipy.fft.set_global_backend(Zero); scipy.fft.register_backend(Zero)",
    "workers": "KEPT.append(scipy.fft.set_workers(2)); KEPT[-1].__enter__()",
    "close": "sys.stdout.close(); sys.stderr.close()",
    "wrap": "io.TextIOWrapper(sys.stdout.buffer); gc.collect()",
    "none": "sys.stdout = sys.stderr = None",
    "original": "sys.__stdout__.close(); sys.__stderr__.close()",
    "descriptors": "os.close(1); os.close(2)",
}
ALONE = {  # what no process can undo: the others have a process of their own
    "nice": "os.nice(5)",
    "hard limit": "resource.setrlimit(resource.RLIMIT_CORE, (0, 0))",
    "class": "pd.DataFrame = None",
    "thread": "threading.Thread(target=lambda: time.sleep(60), daemon=True, name='left').start()",
    "child": "subprocess.Popen(['sleep', '60'])",
}
HEAD = """
import decimal, gc, io, locale, logging, os, resource, signal, subprocess, sys, threading, time
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pandas as pd
import scipy.fft
from threadpoolctl import threadpool_info

from isacbench.model.cloud import PointCloud

KEPT = []

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
        mask = os.umask(0)
        os.umask(mask)
        for stream in (sys.stdout, sys.stderr, sys.__stdout__, sys.__stderr__):
            stream.write("")
            stream.flush()
        os.fstat(1), os.fstat(2)
        parts = [
            gc.isenabled(), gc.get_threshold(), mask, resource.getrlimit(resource.RLIMIT_NOFILE),
            resource.getrlimit(resource.RLIMIT_CORE), os.environ.get("TZ"), time.tzname,
            os.sched_getaffinity(0), [one["num_threads"] for one in threadpool_info()], np.geterr(),
            sys.getswitchinterval(), decimal.getcontext().prec, locale.setlocale(locale.LC_ALL),
            np.pi, np.linalg.svd.__name__, scipy.fft.fft.__name__,
            PointCloud.to_dataframe is None, sys.gettrace(),
            signal.pthread_sigmask(signal.SIG_BLOCK, ()), logging.root.manager.disable,
            threading.gettrace(), threading.getprofile(), sys.argv, logging.root.level,
            len(logging.root.handlers), scipy.fft.fft([1.0, 1.0]), scipy.fft.get_workers(),
            sys.modules["pandas"] is None, len(sys.meta_path),
            os.getpriority(os.PRIO_PROCESS, 0), pd.DataFrame.__name__,
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
    if at_import and act in ("zone", "root logger"):
        pytest.skip("a plugin may set the environment and the root logger when it is imported")
    (undisturbed,) = reason_beside("pass", None)
    assert reason_beside(ACTS[act], None, at_import) == {undisturbed}


@pytest.mark.parametrize("at_import", [False, True], ids=["in estimate", "at import"])
def test_no_plugin_meets_the_process_that_another_has_changed(reason_beside, at_import):
    (undisturbed,) = reason_beside("pass", 1)
    acts = {**ALONE, **ACTS, "constant": "np.pi = 3.0"}
    if at_import:  # which the caller of the run does as well
        acts = {name: acts[name] for name in ("errors", "library", "method", "constant")}
    everything = "; ".join(act for name, act in acts.items() if name != "wrap")
    assert reason_beside(everything, 1, at_import) == {undisturbed}


def test_what_a_plugin_has_left_running_stands_still_while_others_work(tiny, write_plugin, tmp_path):
    stamps = tmp_path / "stamps"
    busy = f"subprocess.Popen(['sh', '-c', 'while :; do date +%s.%N >> {stamps}; sleep 0.01; done'])"
    plain = (
        WITNESS.split("        mask")[0]
        + f"""
        before = open({str(stamps)!r}).read()
        time.sleep(0.5)
        after = open({str(stamps)!r}).read()
        raise RuntimeError(f"{{len(after) - len(before)}} written, {{len(before) > 0}}")
"""
    )
    files = [
        write_plugin("vandal.py", HEAD + VANDAL.replace("ACT", f"{busy}; time.sleep(0.3)")),
        write_plugin("witness.py", HEAD + plain),
    ]
    suite = Suite(name="t", scenarios=[str(tiny)], estimators=["oracle"], snr_db=[0], trials=1)
    rows = run(suite, estimators=["vandal", "witness"], plugins=files, jobs=1)
    assert rows["reason"].tolist() == ["", "RuntimeError: 0 written, True (witness.py, line 29, in estimate)"]
    size = stamps.stat().st_size
    time.sleep(0.2)
    assert stamps.stat().st_size == size  # it ended with the run
