"""A real scheduler and real workers, in processes of their own."""

import asyncio
import json
import os
import signal
import subprocess
import sys
from concurrent.futures import CancelledError
from contextlib import closing
from queue import SimpleQueue
from textwrap import dedent
from threading import Thread
from types import SimpleNamespace

import pandas as pd
import psutil
import pytest
from distributed import Client, LocalCluster
from typer.testing import CliRunner

from isacbench.bench.cells.cell import Limits
from isacbench.bench.cells.cluster import Order, make_rows, stop
from isacbench.bench.cells.plan import load_job
from isacbench.bench.cells.rows import TIMES
from isacbench.bench.run.runner import RunOptions, run, run_suite
from isacbench.bench.suites.suite import Suite
from isacbench.cli import app
from isacbench.errors import InputError
from isacbench.plugins.discovery import load_plugin_file
from tests.conftest import PLUGINS, PluginFolder, estimator_source, wait_until

pytestmark = pytest.mark.first

DEEDS = {
    "slow": "time.sleep(0.1)",
    "crash": "os._exit(7)",
    "environment": 'raise RuntimeError(os.environ.get("MALLOC_TRIM_THRESHOLD_", "nothing"))',
    # Kills the Dask worker, two generations above.
    "deadly": """
        server = open(f"/proc/{os.getppid()}/stat").read()
        os.kill(int(server.rpartition(")")[2].split()[1]), signal.SIGKILL)
        time.sleep(60)
    """,
}
SLOW = "".join(estimator_source(name, dedent(deed)) for name, deed in DEEDS.items())

QUIET = {
    "DASK_DISTRIBUTED__ADMIN__SYSTEM_MONITOR__INTERVAL": "10s",
    "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "1s",
    "DASK_DISTRIBUTED__WORKER__MEMORY__MONITOR_INTERVAL": "5s",
    "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
}
"""Settings with which processes of Dask do not watch themselves many times a second."""


class Cluster:
    """Processes of a scheduler and its workers."""

    def __init__(self, folder, **environment):
        self.folder, self.environment = folder, {**QUIET, **environment}
        self.processes = []
        self.scheduler = self.start("scheduler", "--host", "127.0.0.1", "--port", "0")
        wait_until(self.read_address)
        self.address = self.read_address()

    def read_address(self):
        """Address of the scheduler, once it has written it."""
        try:
            return json.loads((self.folder / "scheduler.json").read_text())["address"]
        except (FileNotFoundError, json.JSONDecodeError):
            return None

    def start(self, role, *args):
        command = [sys.executable, "-m", "dask", role, "--scheduler-file", "scheduler.json", "--no-dashboard"]
        with (self.folder / f"{role}-{len(self.processes)}.log").open("wb") as log:
            process = subprocess.Popen(
                [*command, *args], cwd=self.folder, env={**os.environ, **self.environment}, stderr=log
            )
        self.processes.append(process)
        return process

    def start_workers(self, n, *args):
        with Client(self.address, set_as_default=False) as client:
            n_before = len(client.nthreads())
            started = [self.start("worker", *(args or ("--nthreads", "1"))) for _ in range(n)]
            client.wait_for_workers(n_before + n, timeout=60)
        return started

    def close(self):
        # The scheduler last: workers look for one that is gone.
        for processes in (self.processes[1:], self.processes[:1]):
            for process in processes:
                process.terminate()
            for process in processes:
                process.wait(60)


@pytest.fixture(scope="module")
def installed(plugin_library):
    """Folder with the plugins of the fixture `plugins`, for the workers."""
    return plugin_library.path


@pytest.fixture(scope="module")
def cluster(tmp_path_factory, installed):
    # A nanny would start its worker with this variable, and take as long again.
    environment = {"PYTHONPATH": str(installed), "MALLOC_TRIM_THRESHOLD_": "65536"}
    with closing(Cluster(tmp_path_factory.mktemp("cluster"), **environment)) as found:
        found.start_workers(1, "--no-nanny", "--nthreads", "2")
        yield found


@pytest.fixture
def slow(suite, write_plugin):
    load_plugin_file(write_plugin("slow.py", SLOW))
    return suite.replace(estimators=["slow", "blob"], trials=6)


@pytest.fixture(autouse=True)
def quick_despair(monkeypatch):
    monkeypatch.setattr("isacbench.bench.cells.cluster.WAIT_S", 5.0)


def apart_from_times(records):
    return records.drop(columns=TIMES)


def lanes_left(cluster):
    """Processes that cells run in, below a worker's server of processes, that do not end by themselves."""
    alive = [process for process in cluster.processes if process.poll() is None]
    below = [child for process in alive for child in psutil.Process(process.pid).children(recursive=True)]
    servers = [process for process in below if "forkserver" in " ".join(process.cmdline())]
    lanes = [child for server in servers for child in server.children()]
    return psutil.wait_procs(lanes, timeout=5)[1]  # those that were killed take a moment


def test_the_table_is_that_of_a_local_run_and_a_crash_costs_its_own_cells(
    cluster, suite, write_plugin, tiny, tmp_path, monkeypatch
):
    report = SimpleNamespace(write_report=lambda *_: ([], []))
    monkeypatch.setitem(sys.modules, "isacbench.report.run_report", report)
    plugin = write_plugin("slow.py", SLOW)
    names = ("blob", "crash", "environment", "seer")
    estimators = [word for name in names for word in ("-e", name)]
    command = ["run", "quick", "-s", tiny, *estimators, "--snr", "-5,5", "-n", 1, "--plugin", plugin]
    outputs = []
    for options in (["--dask", cluster.address, "-o", tmp_path / "far"], ["-j", 1, "-o", tmp_path / "near"]):
        result = CliRunner().invoke(app, [str(word) for word in [*command, *options]])
        assert result.exit_code == 3, result.output
        outputs.append(result.stderr)
    assert outputs[0] == outputs[1]
    assert outputs[0].startswith("isacbench: 4 of 8 cells failed, the first one crash on tiny")
    far, near = (pd.read_parquet(tmp_path / name / "results.parquet") for name in ("far", "near"))
    pd.testing.assert_frame_equal(apart_from_times(far), apart_from_times(near))
    clouds = [(tmp_path / name / "clouds.parquet").read_bytes() for name in ("far", "near")]
    assert clouds[0] == clouds[1]
    assert set(far.loc[far["estimator"] == "crash", "reason"]) == {"the process exited with code 7"}
    # Cells do not get the allocator that workers have from their nannies.
    assert set(far.loc[far["estimator"] == "environment", "reason"]) == {
        "RuntimeError: nothing (slow.py, line 65, in estimate)"
    }
    assert not lanes_left(cluster)


def test_a_run_goes_on_where_a_worker_is_killed_and_no_row_is_lost_or_doubled(cluster, slow):
    (victim,) = cluster.start_workers(1, "--no-nanny", "--nthreads", "1", "--name", "victim")
    busy = []

    def kill(n_done, _):
        if not busy and n_done >= 4:
            with Client(cluster.address, set_as_default=False) as client:
                workers = client.scheduler_info(n_workers=-1)["workers"]
                address = next(key for key, value in workers.items() if value["name"] == "victim")
                busy.extend(client.processing()[address])
            victim.kill()

    records = run_suite(slow, progress=kill, options=RunOptions(dask=cluster.address)).rows
    assert busy
    assert victim.wait() == -signal.SIGKILL
    pd.testing.assert_frame_equal(apart_from_times(records), apart_from_times(run(slow)))


def test_a_plugin_that_workers_lack_is_told_before_anything_is_made(cluster, suite, plugin_folder, tmp_path):
    source = PLUGINS.replace('"seer"', '"ghost"')
    plugin_folder.install("test-ghosts", source, estimators={"ghost": "Seer"})
    with pytest.raises(InputError, match=r"worker tcp://\S+: unknown estimator 'ghost'.*before starting"):
        run(suite, estimators=["ghost"], dask=cluster.address, out=tmp_path / "run")
    assert not (tmp_path / "run").exists()
    assert not lanes_left(cluster)


@pytest.fixture
def changed_plugins(plugin_folder, tiny, monkeypatch):
    """Install the plugins with another code than workers have."""
    monkeypatch.delitem(sys.modules, "test_plugins", raising=False)
    source = PLUGINS.replace("np.zeros(self.n)", "np.full(self.n, 1.0)")
    names = {"blob": "Blob", "seer": "Seer"}
    plugin_folder.install("test-plugins", source, estimators=names, detectors={"level": "Level"})
    return Suite(name="test", scenarios=[str(tiny)], estimators=["blob"], snr_db=[0], trials=1)


def test_another_code_of_a_plugin_is_told_and_may_do_where_versions_may_be_mixed(cluster, changed_plugins):
    told = r"worker tcp://\S+: blob: plugins test-plugins digest [0-9a-f]{12} instead of [0-9a-f]{12}"
    with pytest.raises(InputError, match=told):
        run(changed_plugins, dask=cluster.address)
    records = run(changed_plugins, dask=cluster.address, mix_versions=True)
    assert set(records["status"]) == {"ok"}


def test_an_interrupt_keeps_the_rows_so_far_and_leaves_no_process_behind(cluster, slow, tmp_path):
    def interrupt(n_done, _):
        if n_done == 5:
            raise KeyboardInterrupt

    out, options = tmp_path / "run", RunOptions(dask=cluster.address)
    results = run_suite(slow, out, interrupt, options)
    assert results.manifest["interrupted"]
    assert len(results.rows) == 5
    assert not lanes_left(cluster)
    again = run_suite(slow.replace(trials=1), tmp_path / "other", options=options)
    assert not again.manifest["interrupted"]


@pytest.mark.slow
def test_a_lost_scheduler_is_told_and_the_run_goes_on_elsewhere(slow, tmp_path, installed, capfd):
    slow = slow.replace(trials=8)
    with closing(Cluster(tmp_path, PYTHONPATH=str(installed))) as lost:
        (orphan,) = lost.start_workers(1, "--no-nanny", "--nthreads", "1")

        def kill(n_done, _):
            if n_done == 4:
                lost.scheduler.kill()

        with pytest.raises(InputError, match=r"scheduler is gone; the rows so far are kept"):
            run_suite(slow, tmp_path / "run", kill, RunOptions(dask=lost.address))
        orphan.kill()  # it would look for its scheduler for a while
    assert capfd.readouterr().err == ""
    done = []
    rest = run_suite(slow, tmp_path / "run", lambda *counts: done.append(counts))
    assert 4 <= 32 - len(done) < 32
    pd.testing.assert_frame_equal(apart_from_times(rest.rows), apart_from_times(run(slow)))


def test_a_scheduler_without_workers_is_told(suite, monkeypatch):
    monkeypatch.setattr("isacbench.bench.cells.cluster.WAIT_S", 0.3)
    alone = LocalCluster(n_workers=0, host="127.0.0.1", dashboard_address=":0")
    with alone as empty, pytest.raises(InputError, match=r"no worker for 0\.3 s; start some"):
        run(suite, dask=empty.scheduler_address)


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("tcp://127.0.0.1:1", r"no scheduler there \(Timed out .*\); give the address"),
        ("nonsense", r"dask nonsense: no scheduler there \(missing port number"),
    ],
)
def test_an_address_without_a_scheduler_is_told(suite, tmp_path, monkeypatch, address, message):
    monkeypatch.setattr("isacbench.bench.cells.cluster.WAIT_S", 0.2)
    with pytest.raises(InputError, match=message):
        run(suite, dask=address, out=tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_missing_package_is_told_with_the_extra_that_brings_it(suite, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    monkeypatch.delitem(sys.modules, "isacbench.bench.cells.cluster")
    with pytest.raises(InputError, match=r"pip install 'isacbench\[distributed\]'"):
        run(suite, dask="tcp://127.0.0.1:1")


def test_nothing_left_to_do_asks_for_no_cluster(suite, tmp_path):
    first = run(suite, out=tmp_path / "run")
    again = run(suite, out=tmp_path / "run", dask="nowhere")
    pd.testing.assert_frame_equal(again, first)


@pytest.mark.slow
@pytest.mark.parametrize(
    "options", [("--nthreads", "1"), ("--no-nanny", "--nthreads", "1"), ("--no-nanny", "--nthreads", "3")]
)
def test_every_sort_of_worker_works(suite, tmp_path, installed, options):
    with closing(Cluster(tmp_path, PYTHONPATH=str(installed))) as found:
        found.start_workers(1, *options)
        records = run(suite, trials=8, dask=found.address)
        assert not lanes_left(found)
    pd.testing.assert_frame_equal(apart_from_times(records), apart_from_times(run(suite, trials=8)))


@pytest.mark.slow
def test_a_cell_that_kills_its_dask_worker_again_and_again_is_killed_and_no_other(
    suite, write_plugin, tmp_path, installed, monkeypatch
):
    monkeypatch.setattr("isacbench.bench.cells.cluster.WAIT_S", 60.0)  # nannies start workers again
    load_plugin_file(write_plugin("slow.py", SLOW))
    patience = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1", "PYTHONPATH": str(installed)}
    with closing(Cluster(tmp_path, **patience)) as found:
        found.start_workers(2)
        records = run(suite, estimators=["blob", "deadly", "seer"], trials=2, snr_db=0, dask=found.address)
    statuses = records.groupby("estimator")["status"].unique().map(list).to_dict()
    assert statuses == {"blob": ["ok"], "deadly": ["killed"], "seer": ["ok"]}
    dead = records[records["estimator"] == "deadly"]
    assert set(dead["reason"]) == {"several Dask workers died in this cell"}
    assert set(dead["n_true"]) == {3}


@pytest.mark.slow
def test_a_later_worker_with_another_plugin_is_told(slow, plugin_folder, tmp_path, installed):
    late = PluginFolder(tmp_path / "late")
    late.path.mkdir()
    late.install("test-plugins", PLUGINS + "\n# changed", estimators={"blob": "Blob"})
    with closing(Cluster(tmp_path, PYTHONPATH=str(installed))) as found:
        found.start_workers(1)
        started = []

        def start(*_):
            if not started:
                found.environment = {"PYTHONPATH": str(late.path)}
                started.append(found.start("worker", "--nthreads", "4"))

        with pytest.raises(InputError, match=r"a worker: .*test-plugins digest"):
            run_suite(slow.replace(trials=200), progress=start, options=RunOptions(dask=found.address))


def children():
    """Processes below this one that cells run in."""
    return {one.pid for one in psutil.Process().children(recursive=True) if one.ppid() != os.getpid()}


def test_processes_end_with_the_task_that_they_were_started_for_or_with_its_run(suite, wreck):
    job, before = load_job(suite), children()
    rows = make_rows(Order.of_job(job, Limits()), job.plan.blocks())
    assert len(rows) == job.plan.n_cells
    assert children() <= before
    job = load_job(suite.replace(estimators=["wreck[kind=loop]"]))
    order, ended = Order.of_job(job, Limits()), SimpleQueue()

    def work():
        try:
            ended.put(make_rows(order, job.plan.blocks()))
        except BaseException as error:
            ended.put(error)

    Thread(target=work, daemon=True).start()
    wait_until(lambda: children() - before)
    asyncio.run(stop(order.token))
    assert isinstance(ended.get(timeout=60), CancelledError)
    assert children() <= before
