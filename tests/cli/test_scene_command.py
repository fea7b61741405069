"""``isacbench scene``, and how scenes of families are refused by every command that takes a scenario."""

import json
import tomllib

import numpy as np
import pytest

from isacbench import load_scenario
from isacbench.files.escaping import file_stems
from isacbench.model.scenes.scene_families import FAMILIES

COMMANDS = {
    "scene": ["scene"],
    "image": ["image", "-e", "fft4d", "-s"],
    "plan": ["plan", "-s"],
    "simulate": ["simulate", "-o", "frame.npy", "-s"],
    "run": ["run", "quick", "-o", "out", "-s"],
}
REFUSED = {
    "twn[seed=1]": "town",
    "town[seed=1,densty=high]": "density",
    "town[seed=0:1000000]": "at most 1000 scenes",
    "town[sed=1]": "did you mean 'seed'?",
    f"town[seed=0:{'9' * 5000}]": "range first:last",
    "town[seed=5:1]": "range first:last",
    "town[seed=-1]": "seed",
    "town[seed=1.5]": "seed",
    "town[density=low]": "town[seed=7]",
    "town": "town[seed=7]",
    "street[seed=1": "street[seed=1",
    "town[seed=1,gain_error_db=-1]": "gain_error_db",
    "town[seed=1,gain_error_db=true]": "gain_error_db",
}


@pytest.fixture
def cli(command_line):
    return command_line


def assert_same_scene(scenario, other):
    for field in ("xyz", "velocity", "amplitude"):
        np.testing.assert_array_equal(getattr(scenario.scatterers, field), getattr(other.scatterers, field))
    fields = "system", "array", "frame", "region", "radius_m", "gain_error_db", "phase_error_deg", "budget"
    for field in fields:
        assert getattr(scenario, field) == getattr(other, field)
    np.testing.assert_array_equal(scenario.base_station_m, other.base_station_m)


@pytest.mark.parametrize(
    "spec",
    [
        *(f"{family}[seed=7]" for family in FAMILIES),
        "town[seed=8,frame=paper,coherent_phase=true,gain_error_db=0.5,phase_error_deg=5.0]",
        "street-coherent",
    ],
)
def test_a_written_scene_is_the_same_bit_for_bit_under_the_name_of_its_file(cli, tmp_path, spec):
    result = cli("scene", spec, "-o", "mine.toml")
    assert result.exit_code == 0, result.output
    assert "'mine'" in result.stdout
    written = load_scenario(tmp_path / "mine.toml")
    assert (written.name, written.family) == ("mine", "")
    assert_same_scene(written, load_scenario(spec))
    assert spec in (tmp_path / "mine.toml").read_text().splitlines()[0]


def test_a_scene_is_printed_under_its_own_name(cli, tmp_path):
    text = cli("scene", "town[density=high,seed=7]").stdout
    assert tomllib.loads(text)["name"] == "town[seed=7,density=high]"
    (tmp_path / "copy.toml").write_text(text)
    assert_same_scene(load_scenario(tmp_path / "copy.toml"), load_scenario("town[seed=7,density=high]"))


def test_a_scene_is_never_overwritten_and_takes_the_suffix_of_a_scenario(cli, tmp_path):
    (tmp_path / "mine.toml").write_text("edited")
    for out, said in (("mine.toml", "not overwritten"), ("mine.txt", ".toml"), ("no/mine.toml", "folder")):
        result = cli("scene", "town[seed=7]", "-o", out)
        assert result.exit_code == 2
        assert said in result.stderr
    assert (tmp_path / "mine.toml").read_text() == "edited"


def test_a_copy_stays_with_the_csv_that_it_reads(cli, tiny, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    result = cli("scene", "tiny.toml", "-o", "elsewhere/copy.toml")
    assert result.exit_code == 2
    assert "tiny.csv" in result.stderr
    assert cli("scene", "tiny.toml", "-o", "copy.toml").exit_code == 0
    assert_same_scene(load_scenario(tmp_path / "copy.toml"), load_scenario(tiny))


@pytest.mark.parametrize(
    ("command", "spec"),
    [*(("image", spec) for spec in REFUSED), *((command, "twn[seed=1]") for command in COMMANDS)],
)
def test_every_command_refuses_a_misspelt_scene_in_one_line(cli, tmp_path, command, spec):
    result = cli(*COMMANDS[command], spec)
    assert result.exit_code == 2, result.output
    assert result.stderr.startswith("isacbench: ")
    assert result.stderr.count("\n") == 1
    assert REFUSED[spec] in result.stderr
    assert not list(tmp_path.iterdir())


def test_commands_on_one_scenario_refuse_a_range_of_seeds(cli, tmp_path):
    for command in COMMANDS.keys() - {"run"}:
        result = cli(*COMMANDS[command], "town[seed=0:1]")
        assert result.exit_code == 2, command
        assert "2 scenes" in result.stderr
        assert not list(tmp_path.iterdir()), command


def test_families_are_listed_with_version_parameters_and_defaults(cli):
    families = {entry["name"]: entry for entry in json.loads(cli("list", "--json").stdout)["families"]}
    streets = {"street", "town", "facade", "crowd", "weak", "sparse", "traffic", "crossing"}
    assert set(families) == {*streets, "uma-av"}
    assert all(entry["version"] >= 1 and entry["description"] for entry in families.values())
    parameters = families["town"]["parameters"]
    assert "default" not in parameters["seed"]
    assert parameters["density"] == {
        "type": "string",
        "allowed": "low or medium or high",
        "default": "medium",
    }
    assert "density: string, low or medium or high = medium" in cli("list").stdout


def test_files_of_generated_scenes_have_readable_and_unique_stems():
    names = ["town[seed=7]", "town[seed=7,frame=paper]", "town-seed-7"]
    assert list(file_stems(names).values()) == ["town-seed-7", "town-seed-7-frame-paper", "town-seed-7-2"]


def test_a_picture_without_a_file_is_named_after_scene_and_estimator(cli, monkeypatch):
    drawn = []
    monkeypatch.setattr("isacbench.report.clouds.plot_clouds", lambda *_, out, **__: drawn.append(str(out)))
    for words in ("--plot -e oracle", "-e oracle --plot"):
        named = cli("image", "-s", "sparse[seed=3]", *words.split())
        assert named.exit_code == 0, named.output
        assert "picture: sparse-seed-3-oracle.png" in named.output
    assert drawn == ["sparse-seed-3-oracle.png"] * 2


def test_a_cloud_of_a_drop_without_targets_is_scored_by_its_false_alarms(cli, tmp_path):
    (tmp_path / "cloud.csv").write_text("x,y,z,v,power\n0,-100,60,1,1\n")
    scored = cli("score", "uma-av[seed=1,targets=0]", "cloud.csv", "--metric", "nr-isac", "--json")
    assert scored.exit_code == 0, scored.output
    scores = json.loads(scored.stdout)
    assert (scores["false_alarm_type1"], scores["missed_detection"]) == (1.0, None)
    assert cli("score", "uma-av[seed=1,targets=0]", "cloud.csv").exit_code == 2
