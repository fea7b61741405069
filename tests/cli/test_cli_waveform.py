import json
from functools import partial

import numpy as np
import pytest

from isacbench.link.waveform.figures_of_merit import draw_papr_db
from isacbench.link.waveform.resource_grid import draw_grid
from isacbench.model.scenes.scenario import load_scenario
from isacbench.report.drawing.style import new_figure
from isacbench.report.figures import waveform_figures


@pytest.fixture
def cli(tiny, command_line):
    """Run the command line in a folder that holds a small scenario."""
    return partial(command_line, "waveform", "-s", "tiny.toml")


def test_it_prints_tables_and_no_figure_unless_asked(cli, tmp_path):
    before = set(tmp_path.iterdir())
    result = cli("--frames", 2)
    assert result.exit_code == 0, result.output
    for text in ("sampling rate", "share of the PRS", "qpsk", "256qam", "theory", "with suffix"):
        assert text in result.output
    assert set(tmp_path.iterdir()) == before


def test_json_holds_what_the_modules_compute(cli):
    result = cli("--frames", 2, "--modulation", "16qam", "--modulation", "16qam", "--seed", 5, "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.output)
    system = load_scenario("tiny.toml").system
    assert list(found["modulations"]) == ["16qam"]
    told = found["modulations"]["16qam"]
    assert told["n_data_bits"] == draw_grid(system, "16qam").bits.size
    assert told["papr"]["n_symbols"] == 2 * system.n_symbols
    assert told["papr"]["median_db"] == np.median(draw_papr_db(system, "16qam", 2, seed=5))
    assert found["sampling_rate_hz"] == system.bandwidth_hz


def test_figures_are_drawn_into_a_folder_and_named(cli, tmp_path, monkeypatch):
    for name in ("draw_spectrum", "draw_papr", "draw_resource_grid"):
        monkeypatch.setattr(waveform_figures, name, lambda *_: new_figure(1, 1))
    result = cli("--frames", 1, "--modulation", "qpsk", "-o", "figures")
    assert result.exit_code == 0, result.output
    names = {"spectrum.png", "papr.png", "grid.png"}
    assert {path.name for path in (tmp_path / "figures").iterdir()} == names
    assert all(name in result.output for name in names)


def test_a_modulation_that_does_not_exist_is_a_mistake(cli):
    result = cli("--modulation", "8psk")
    assert result.exit_code == 2
    assert "unknown modulation '8psk'" in result.output


def test_a_prefix_of_no_whole_samples_is_a_mistake(cli, tmp_path):
    path = tmp_path / "tiny.toml"
    text = path.read_text()
    assert "[system]" in text
    path.write_text(text.replace("[system]", "[system]\ncyclic_prefix_ratio = 0.2345"))
    result = cli()
    assert result.exit_code == 2
    assert "cyclic_prefix_ratio = 0.2345: allowed is a whole number of samples" in result.output
