"""The command line, run in the process of the tests and in a folder of its own."""

import pytest
from typer.testing import CliRunner

from isacbench.cli import app


@pytest.fixture
def command_line(tmp_path, monkeypatch):
    """Return a function that runs the command line in the folder of the test."""
    monkeypatch.chdir(tmp_path)
    return lambda *args: CliRunner().invoke(app, [str(arg) for arg in args])


@pytest.fixture
def drawn_runs(monkeypatch):
    """Folders of the runs that have been asked to be drawn; none is."""
    folders = []
    drawing = "isacbench.report.run_report.draw_with_page"
    monkeypatch.setattr(drawing, lambda run, *_: folders.append(run.folder) or [run.folder / "deviation.png"])
    return folders


@pytest.fixture
def cli(plugins, tiny, drawn_runs, command_line):
    """Run the command line in a folder that holds a small scenario, without drawing figures."""
    return command_line
