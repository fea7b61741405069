"""What every hostile file is read under: a clock against hanging, and a limit of memory."""

from __future__ import annotations

import resource
import signal
from contextlib import contextmanager
from pathlib import Path

import pytest

from isacbench.bench.run.runner import run_suite
from isacbench.bench.suites.suite import Suite
from isacbench.errors import InputError
from isacbench.report import figures, run_report
from isacbench.report.figures import new_figure
from tests.conftest import TINY, TINY_POINTS

HANGS_S = 120
"""Nobody waits longer; whatever is slow on a busy machine is far from it."""

ROOM_BYTES = 3 * 2**29
"""Memory that a reader may add: a few times what its limits allow, far from what the files claim."""

LONGEST = 2000
"""Characters of a message that a person reads."""


@contextmanager
def limited(path="this"):
    """Turn hanging into a failure, and more memory than allowed into an error."""

    def hang(_signal, _frame):
        pytest.fail(f"{path} hangs")

    before = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    handler = signal.signal(signal.SIGALRM, hang)
    signal.alarm(HANGS_S)
    resource.setrlimit(resource.RLIMIT_AS, (used + ROOM_BYTES, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
        signal.alarm(0)
        signal.signal(signal.SIGALRM, handler)


def chain_of(error):
    while error is not None:
        yield error
        error = error.__cause__


@pytest.fixture
def refused():
    """Return a function that reads what must be refused, and returns the words."""

    def read(reader, path):
        with limited(path):
            try:
                reader(path)
            except InputError as error:
                found = error
            except Exception as error:
                raise AssertionError(f"{path} raises {error!r}") from error
            else:
                pytest.fail(f"{path} is read")
        message = str(found)
        assert str(path) in message
        assert len(message.replace(str(path), "")) < LONGEST, path
        # Memory that ran out is no refusal: it was taken before.
        assert not any(isinstance(error, MemoryError) for error in chain_of(found)), path
        return message

    return read


@pytest.fixture
def bounded():
    """Return the guard alone, for what may be read as well."""
    return limited


@pytest.fixture(scope="session")
def made(tmp_path_factory):
    """Return a suite and the folder of its run."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "tiny.toml").write_text(TINY)
    (folder / "tiny.csv").write_text(TINY_POINTS)
    suite = Suite(
        name="test", scenarios=[str(folder / "tiny.toml")], estimators=["oracle"], snr_db=[0, 10], trials=2
    )
    run_suite(suite, out=folder / "run")
    return suite, folder / "run"


@pytest.fixture
def written_empty(monkeypatch):
    """Leave figures empty, and write all of them."""
    for module, name in ((figures, "draw_charts"), (run_report, "draw_clouds")):
        monkeypatch.setattr(module, name, lambda *_: new_figure(1, 1))
