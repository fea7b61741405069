import json
import os
import re
import signal
import subprocess
import sys
from contextlib import suppress
from itertools import islice
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

import isacbench
from isacbench.bench.cells.worker import rows_here
from isacbench.cli.run_commands import Termination
from isacbench.model.cloud import PointCloud
from isacbench.model.scenes.scenario import load_scenario

HEAVY = {"matplotlib", "numpy", "pandas", "pyarrow", "pydantic", "scipy", "skimage"}
DRAWING = "isacbench.report.run_report.draw_with_page"
CLOUD = "x,y,z,v,power\n1,2,3,0,1\n5,6,1,10,4\n"


@pytest.fixture(autouse=True)
def drawn(monkeypatch, drawn_runs):
    """Record what is drawn, runs and pictures, instead of drawing it."""
    plotting = ModuleType("isacbench.report.clouds")
    plotting.plot_clouds = lambda truth, estimate, *, out, **_: drawn_runs.append(out)
    monkeypatch.setitem(sys.modules, plotting.__name__, plotting)
    return drawn_runs


@pytest.fixture(autouse=True)
def handlers():
    """Handle signals as in the foreground of a shell, also where the tests run in its background."""
    usual = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
    before = {number: signal.signal(number, handler) for number, handler in usual.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


RUN = ("run", "quick", "-s", "tiny.toml", "-e", "blob", "-e", "blob[n=5]", "-e", "seer")


def test_run_writes_rows_manifest_and_tables_draws_and_prints_a_summary_and_report_does_so_again(
    cli, tiny, tmp_path, drawn
):
    result = cli(*RUN, "--snr", "-5:5:5", "-n", 2, "--seed", 3, "-o", "out")
    assert result.exit_code == 0, result.output
    assert result.stderr == ""  # no progress where there is no terminal
    records = pd.read_parquet(tmp_path / "out" / "results.parquet")
    assert len(records) == 3 * 3 * 2
    assert sorted(records["snr_db"].unique()) == [-5, 0, 5]
    assert set(records["seed"]) == {3}
    assert set(records["scenario"]) == {"tiny"}
    assert {"manifest.json", "results.csv", "clouds.parquet", "truth.parquet", "summary.csv"} <= {
        path.name for path in (tmp_path / "out").iterdir()
    }
    assert "blob[n=5]" in result.stdout
    assert "deviation.png" in result.stdout
    assert len(drawn) == 1
    first = (tmp_path / "out" / "summary.csv").read_bytes()
    (tmp_path / "out" / "summary.csv").unlink()
    tiny.unlink()
    again = cli("report", "out")
    assert again.exit_code == 0, again.output
    assert (tmp_path / "out" / "summary.csv").read_bytes() == first
    assert len(drawn) == 2


def test_run_takes_a_suite_by_path_with_scenarios_beside_it_and_makes_a_fresh_folder(cli, tmp_path):
    (tmp_path / "suites").mkdir()
    (tmp_path / "suites" / "mine.toml").write_text(
        'name = "mine"\nscenarios = ["../tiny.toml"]\nestimators = ["seer"]\nsnr_db = [0]\ntrials = 1\n'
    )
    result = cli("run", "suites/mine.toml")
    assert result.exit_code == 0, result.output
    (folder,) = (tmp_path / "results").iterdir()
    assert folder.name.startswith("mine-")
    assert set(pd.read_parquet(folder / "results.parquet")["suite"]) == {"mine"}


STUDY = (
    'name = "s"\nscenarios = ["room.toml"]\nestimators = ["seer", "blob"]\nsnr_gain_db = [20]\ntrials = 2\n'
)
RESOLUTION = f'kind = "resolution"\nseparations_cells = [0.5]\ndimensions = ["u"]\n{STUDY}'
DETECTION = (
    'kind = "detection"\nname = "s"\nscenarios = ["tiny.toml"]\nestimators = ["blob"]\n'
    'detectors = ["ca"]\nmaps = ["homogeneous"]\nsnr_db = [-36]\ntrials = 1\n'
)


@pytest.mark.parametrize(
    ("text", "column", "printed"),
    [(RESOLUTION, "resolved", "share of pairs found"), (DETECTION, "n_hits", "homogeneous: P_d and P_fa")],
)
def test_a_study_is_run_tabulated_drawn_and_reported_again(
    cli, room_file, tmp_path, drawn, text, column, printed
):
    (tmp_path / "s.toml").write_text(text)
    result = cli("run", "s.toml", "-n", 1, "--seed", 3, "-o", "out")
    assert result.exit_code == 0, result.output
    records = pd.read_parquet("out/results.parquet")
    assert column in records
    assert set(records["seed"]) == {3}
    assert printed in result.stdout
    hold_report(cli, result)
    assert len(drawn) == 2


def hold_report(cli, result):
    """Hold a report to what the run printed and wrote."""
    first = contents(Path("out"))
    again = cli("report", "out")
    assert again.exit_code == 0, again.output
    assert again.stdout == result.stdout
    assert contents(Path("out")) == first


def test_options_replace_what_a_study_says(cli, room_file, tmp_path):
    (tmp_path / "s.toml").write_text(f'kind = "efficiency"\n{STUDY}'.replace("room.toml", "gone.toml"))
    result = cli("run", "s.toml", "-s", "room.toml", "-e", "seer", "--snr", "-40,-30", "-n", 3, "-o", "out")
    assert result.exit_code == 0, result.output
    assert "room, seer: error over Cramér-Rao bound" in result.stdout
    records = pd.read_parquet("out/results.parquet")
    assert "bound_u" in records
    assert sorted(records["snr_db"].unique()) == [-40, -30]
    assert (set(records["estimator"]), records["trial"].max()) == ({"seer"}, 2)
    hold_report(cli, result)


def test_run_with_failed_cells_keeps_all_rows_names_the_first_and_exits_3(cli):
    result = cli(*RUN, "-e", "trouble", "-n", 1, "--snr", "0", "-o", "out")
    assert result.exit_code == 3
    assert result.stderr == (
        "isacbench: 1 of 4 cells failed, the first one trouble on tiny at 0 dB, trial 0: "
        "error, ZeroDivisionError: no luck (test_plugins.py, line 68, in estimate); "
        "again: isacbench image -s tiny.toml -e trouble --snr 0\n"
    )
    assert "| isacbench image -s tiny.toml -e trouble --snr 0 |" in Path("out/summary.md").read_text()
    assert len(pd.read_parquet("out/results.parquet")) == 4


@pytest.mark.parametrize("is_lost", [False, True])
@pytest.mark.parametrize(
    ("number", "code", "word"), [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "terminated")]
)
def test_a_signal_ends_the_run_which_tabulates_its_rows_also_where_the_exception_is_lost(
    cli, monkeypatch, tmp_path, is_lost, number, code, word
):
    def work(job, blocks, *_):
        rows = rows_here(job, blocks)
        yield from islice(rows, 2 if is_lost else 3)
        with suppress(*[KeyboardInterrupt] * is_lost):  # as Python does within `__del__`
            signal.raise_signal(number)
        yield from rows

    before = signal.getsignal(number)
    monkeypatch.setattr("isacbench.bench.run.runner.rows_guarded", work)
    result = cli(*RUN, "-o", "out")
    assert result.exit_code == code
    assert "deviation" in result.stdout
    assert result.stderr == f"isacbench: {word}: the 3 cells so far are in out\n"
    assert len(pd.read_parquet("out/results.parquet")) == 3
    assert (tmp_path / "out" / "summary.csv").exists()
    assert signal.getsignal(number) is before


def terminated():
    """Receive the signal, unless that would end the tests."""
    assert signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL
    os.kill(os.getpid(), signal.SIGTERM)


@pytest.mark.parametrize(
    ("place", "left", "n_rows"),
    [
        ("isacbench.bench.run.runner.load_job", "nothing is done yet", 0),
        (DRAWING, "what is done so far is in out; isacbench report out tabulates it", 3),
    ],
    ids=["before its first cell", "while it draws"],
)
def test_a_run_that_is_terminated_exits_143_and_says_what_is_left(cli, monkeypatch, place, left, n_rows):
    monkeypatch.setattr(place, lambda *_: terminated())
    result = cli(*RUN, "-n", 1, "--snr", "0", "-o", "out")
    assert (result.exit_code, result.stderr) == (143, f"isacbench: terminated: {left}\n")
    assert Path("out").exists() == bool(n_rows)
    assert not n_rows or len(pd.read_parquet("out/results.parquet")) == n_rows


def test_a_second_termination_ends_at_once_and_an_echo_of_the_first_does_not(monkeypatch):
    codes = []
    monkeypatch.setattr(os, "_exit", codes.append)
    with Termination() as termination:
        with pytest.raises(KeyboardInterrupt):
            terminated()
        terminated()
        assert codes == []
        termination._received_s[signal.SIGTERM] -= 2
        terminated()
        assert codes == [143]


def test_a_run_from_python_installs_no_handler(plugins, tiny, monkeypatch):
    handlers = []

    def work(*args):
        handlers.append(signal.getsignal(signal.SIGTERM))
        yield from rows_here(*args)

    monkeypatch.setattr("isacbench.bench.run.runner.rows_here", work)
    isacbench.run("quick", scenarios=[tiny], estimators=["blob"], snr_db=[0], trials=1)
    assert handlers == [signal.SIG_DFL]


def test_list_names_everything_with_parameters_and_defaults(cli):
    text = cli("list").stdout
    assert "blob" in text
    assert "n: int = 4" in text
    content = json.loads(cli("list", "--json").stdout)
    assert set(content) == {"estimators", "detectors", "metrics", "scenarios", "families", "suites"}
    blob = next(entry for entry in content["estimators"] if entry["name"] == "blob")
    assert blob["parameters"]["mode"]["default"] == "near"
    assert {"street", "street-paper"} <= {entry["name"] for entry in content["scenarios"]}
    assert {"detectors", "efficiency", "paper", "quick", "resolution"} <= {
        entry["name"] for entry in content["suites"]
    }
    assert all(entry["description"] for entries in content.values() for entry in entries)


def test_image_writes_the_cloud_that_score_reads(cli):
    for suffix in ("csv", "npy", "mat", "ply"):
        out = f"cloud.{suffix}"
        result = cli("image", "-s", "tiny.toml", "-e", "blob[n=5]", "--snr", "-5", "--trial", 2, "-o", out)
        assert result.exit_code == 0, result.output
        assert "5 points" in result.stdout
        scores = json.loads(cli("score", "tiny.toml", out, "--json").stdout)
        assert scores["n_estimated"] == 5, suffix
        assert f"deviation        {scores['deviation']:.6g}" in result.stdout, suffix


def test_image_draws_where_asked(cli, drawn):
    assert cli("image", "-s", "tiny.toml", "-e", "seer", "--plot", "picture.png").exit_code == 0
    assert [str(path) for path in drawn] == ["picture.png"]


def test_image_of_a_scenario_without_objects_draws_the_cloud_alone_and_prints_no_score(
    cli, tiny, tmp_path, drawn
):
    text = tiny.read_text()
    (tmp_path / "bare.toml").write_text(text[: text.index("[[objects]]")])
    result = cli("image", "-s", "bare.toml", "-e", "blob", "--plot", "picture.png")
    assert result.exit_code == 0, result.output
    assert re.fullmatch(r"tiny, blob, 10 dB: 4 points in [^\n]+\n", result.output)
    assert [str(path) for path in drawn] == ["picture.png"]


def test_the_time_of_an_image_is_that_of_a_second_call_unless_that_takes_long(cli, monkeypatch):
    for limit_s, told in (
        (1e9, r"ms \(the first call, with imports and tables: [0-9.]+ ms\)\n"),
        (0, "ms, imports and tables included\n"),
    ):
        monkeypatch.setattr("isacbench.cli.image_commands.REPEATED_S", limit_s)
        result = cli("image", "-s", "tiny.toml", "-e", "blob")
        assert re.search(rf"4 points in [0-9.]+ {told}", result.stdout), limit_s


def test_a_failing_estimator_shows_its_author_where_and_exits_3(cli):
    result = cli("image", "-s", "tiny.toml", "-e", "trouble")
    assert result.exit_code == 3
    assert "ZeroDivisionError: no luck" in result.stderr
    assert "in estimate" in result.stderr


def test_score_of_a_truth_against_itself_is_zero_in_the_pinned_columns(cli, tmp_path):
    (tmp_path / "cloud.csv").write_text(CLOUD)
    scores = json.loads(cli("score", "cloud.csv", "cloud.csv", "--json").stdout)
    assert scores["deviation"] == 0
    assert "deviation        0\n" in cli("score", "cloud.csv", "cloud.csv").stdout
    assert {"hausdorff_xy_m", "velocity_nmse", "chamfer_m", "gospa_m", "n_true"} <= set(scores)
    repository = json.loads(cli("score", "cloud.csv", "cloud.csv", "--json", "--metric", "repository").stdout)
    assert {"position", "velocity", "density", "deviation"} <= set(repository)


@pytest.mark.filterwarnings("default::isacbench.errors.InputWarning")
def test_a_score_that_is_left_out_is_null_in_json_and_told(cli, tmp_path, monkeypatch):
    monkeypatch.setattr("isacbench.metrics.assignment.MOST_PAIRS", 1)
    (tmp_path / "cloud.csv").write_text(CLOUD)
    result = cli("score", "cloud.csv", "cloud.csv", "--json")
    assert result.exit_code == 0
    assert {name for name, value in json.loads(result.stdout).items() if value is None} == {"gospa_m"}
    assert result.stderr.startswith("isacbench: warning: GOSPA of ")
    assert result.stderr.count("\n") == 1


def test_a_score_that_needs_velocities_is_null_for_a_cloud_without_them(cli, tmp_path):
    (tmp_path / "cloud.csv").write_text(CLOUD)
    (tmp_path / "points.csv").write_text("x,y,z\n1,5,2\n")
    for truth in ("tiny.toml", "cloud.csv"):
        result = cli("score", truth, "points.csv", "--json")
        found = {name for name, value in json.loads(result.stdout).items() if value is None}
        assert found == {"velocity_nmse", "deviation"}
        assert not result.stderr
    assert "deviation        nan\n" in cli("score", "cloud.csv", "points.csv").stdout


def test_a_scenario_as_truth_brings_its_region(cli, tmp_path, tiny):
    (tmp_path / "empty.csv").write_text("x,y,z,v,power\n")
    scenario = load_scenario(tiny)
    expected = isacbench.score(scenario.truth, np.empty((0, 4)), region=scenario.region)["deviation"]
    assert json.loads(cli("score", "tiny.toml", "empty.csv", "--json").stdout)["deviation"] == expected


def test_version_is_printed(cli):
    assert cli("--version").stdout == f"isacbench {isacbench.__version__}\n"


UNKNOWN_NAMES = [
    ["run", "quik"],
    ["run", "-e", "musicd"],
    ["run", "-e", "music2d", "-s", "streat"],
    ["image", "-e", "musicd"],
    ["image", "-s", "streat"],
    ["plan", "-e", "musicd"],
    ["simulate", "-s", "streat", "-o", "frame.npy"],
    ["stress", "-e", "musicd"],
    ["stress", "-d", "osc"],
]


def test_help_and_an_unknown_name_are_told_before_anything_slow_is_imported_or_started(tmp_path):
    code = (
        "import json, sys\n"
        "from typer.testing import CliRunner\n"
        "from isacbench.cli import app\n"
        "assert 'stress' in CliRunner().invoke(app, ['--help']).stdout\n"
        "modules = list(sys.modules)\n"
        "told = [CliRunner().invoke(app, words).stderr for words in json.loads(sys.argv[1])]\n"
        "print(json.dumps([told, modules, list(sys.modules)]))"
    )
    finished = subprocess.run(
        [sys.executable, "-c", code, json.dumps(UNKNOWN_NAMES)],
        cwd=tmp_path,
        check=True,
        capture_output=True,
        text=True,
    )
    told, after_help, modules = json.loads(finished.stdout)
    assert not {*after_help} & HEAVY
    assert [text.count("\n") for text in told] == [1] * len(told)
    assert all("did you mean" in text for text in told)
    assert not {*modules} & (HEAVY - {"pydantic"} | {"multiprocessing.forkserver"})


def test_a_mistaken_parameter_is_told_in_one_line_before_anything_is_computed(cli, tmp_path, monkeypatch):
    monkeypatch.setattr("isacbench.bench.cells.process.start_process_server", lambda: None)
    monkeypatch.setattr("isacbench.bench.run.runner.run_suite", lambda *_, **__: pytest.fail("computed"))
    (tmp_path / "s.toml").write_text(DETECTION.replace('["ca"]', '["ca[pfaa=1]"]'))
    for words in (
        "run -e music2d[pfaa=1]",
        "run -e music2d[detector=osc]",
        "run s.toml",
        "stress -e music2d[pfa=2]",
    ):
        result = cli(*words.split())
        assert result.exit_code == 2, result.output
        assert result.stderr.count("\n") == 1, words


AS_A_MODULE = """
import runpy, sys
import isacbench.metrics.occupancy, isacbench.report.run_report
try:
    runpy.run_module("isacbench", run_name="__main__", alter_sys=True)
finally:
    assert "matplotlib.figure" in sys.modules
    assert not {"matplotlib.pyplot", "matplotlib.style", "scipy.stats"} & {*sys.modules}
"""


def test_a_process_finds_a_plugin_on_its_path_and_draws_without_slow_imports(plugins, tiny, tmp_path):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(plugins.path), *sys.path])}
    words = "image -s tiny.toml -e blob -o cloud.csv --plot picture.png"
    finished = subprocess.run(
        [sys.executable, "-c", AS_A_MODULE, *words.split()],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert finished.returncode == 0, finished.stderr
    assert len(PointCloud.read(tmp_path / "cloud.csv")) == 4
    assert (tmp_path / "picture.png").exists()


def test_the_public_names_are_all_there_and_load_on_first_use():
    assert all(hasattr(isacbench, name) for name in isacbench.__all__)
    assert set(isacbench.__all__) <= set(dir(isacbench))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = isacbench.nothing
