import dataclasses

import numpy as np
import pytest

from isacbench.bench.run.runner import run_suite
from isacbench.bench.store.run import Run
from isacbench.bench.studies.population_study import scene_cells, summarise_population
from isacbench.bench.suites.population_kind import PopulationSuite
from isacbench.model.scenes.scenario import load_scenario
from isacbench.report.drawing.style import assign_looks
from isacbench.report.figures import population_figures, run_figures
from isacbench.report.figures.population_figures import (
    CURVES,
    LARGEST_RATIO,
    TARGETS,
    draw_ratios,
    draw_score_curves,
    draw_targets,
)
from isacbench.report.figures.run_figures import draw_run

LOOKS = assign_looks({(name, "{}"): name for name in ("a", "b", "oracle")}, bounds=["oracle"])


@pytest.fixture
def rows(population_rows):
    return population_rows(["town", "crowd", "sparse"], a=np.arange(2.0, 10.0), b=1e6, oracle=2.0)


def dots(axes):
    """Places of all dots of a panel."""
    return np.concatenate([collection.get_offsets() for collection in axes.collections])


def test_every_scene_is_a_dot_in_the_row_of_its_estimator_and_references_are_lines(rows):
    figure = draw_ratios(scene_cells(rows), LOOKS)
    panels = figure.axes
    assert [axes.get_title() for axes in panels] == [
        f"{family}, {snr} dB" for snr in (0, 10) for family in ("town", "crowd")
    ]
    for axes in panels:
        ratio, height = dots(axes).T
        assert sorted(ratio[height < 0.5]) == pytest.approx(np.arange(2.0, 10.0) / 2)
        assert ratio[height > 0.5].tolist() == [LARGEST_RATIO] * 8
        (reference,) = [line for line in axes.lines if line.get_linestyle() == "--"]
        assert list(reference.get_xdata()) == [1, 1]
    first = panels[0]
    assert [label.get_text() for label in first.get_yticklabels()] == ["a", "b"]
    assert first.get_xscale() == "log"


def test_frames_and_phases_have_markers_that_the_legend_names(rows):
    figure = draw_ratios(scene_cells(rows), LOOKS)
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert names == [
        LOOKS["oracle", "{}"].label,
        "frame panel, carrier phases",
        "frame panel, in phase",
        "frame paper, carrier phases",
        "frame paper, in phase",
    ]
    kinds = {
        (tuple(collection.get_facecolor()[0]), len(collection.get_paths()[0].vertices))
        for collection in figure.axes[0].collections[:4]
    }
    assert len(kinds) == 4


def test_scores_have_a_row_each_and_families_a_column_on_one_scale(rows):
    figure = draw_score_curves(summarise_population(rows), LOOKS)
    panels = np.reshape(figure.axes, (len(CURVES), 4))
    assert [axes.get_title() for axes in panels[0]] == ["all scenes", "town", "crowd", "sparse"]
    assert [axes.get_ylabel() for axes in panels[:, 0]] == [curve.axis for curve in CURVES]
    ratio, none = panels[0, 1], panels[0, 3]
    assert ratio.lines[0].get_ydata().tolist() == pytest.approx([2.75, 2.75])
    assert not none.axison
    assert not none.lines
    assert len({axes.get_ylim() for axes in panels[1]}) == 1


def test_at_a_single_snr_estimators_stand_side_by_side(population_rows):
    rows = population_rows(["town"], snrs_db=[10.0], a=2.0, b=3.0, oracle=1.0)
    figure = draw_score_curves(summarise_population(rows), LOOKS)
    recall = figure.axes[4]  # the third row, of all scenes
    assert [tuple(line.get_xydata()[0]) for line in recall.lines] == [(0, 2), (1, 3), (2, 1)]
    assert figure.axes[-1].get_xlabel() == "SNR 10 dB"


def test_targets_of_lone_scatterers_have_a_panel_each(rows):
    rows.loc[rows["family"] == "sparse", "n_false"] = 2
    figure = draw_targets(summarise_population(rows), "sparse", LOOKS)
    assert [axes.get_ylabel() for axes in figure.axes] == [curve.axis for curve in TARGETS]
    assert figure.axes[0].lines[0].get_ydata().tolist() == [2, 2]
    assert figure.get_suptitle() == "sparse: means over 8 scenes, 95 % confidence bands"


@pytest.fixture
def population(plugins, tiny, monkeypatch):
    """Make a suite of two scenes of a family and one of lone scatterers, which load as generated ones do."""

    def load(name):
        family, _, _ = name.partition("[")
        return dataclasses.replace(load_scenario(tiny), name=name, family=family, family_version=1)

    monkeypatch.setattr("isacbench.bench.plan.job.load_scenario", load)

    def make(**changes):
        keys = {
            "name": "population",
            "version": 1,
            "scenarios": ["town[seed=1]", "town[seed=2,frame=paper]", "sparse[seed=3]"],
            "estimators": ["blob", "oracle"],
            "snr_db": [0, 20],
            "trials": 1,
        }
        return PopulationSuite(**{**keys, **changes})

    return make


def test_every_figure_of_a_population_is_written_with_the_worst_scene_of_each_estimator(
    population, tmp_path, monkeypatch
):
    monkeypatch.setattr(population_figures, "CURVES", CURVES[::4])
    titles, save = [], run_figures.save
    monkeypatch.setattr(
        run_figures, "save", lambda figure, path: titles.append(figure.get_suptitle()) or save(figure, path)
    )
    run_suite(population(), tmp_path / "run")
    paths = draw_run(Run.open(tmp_path / "run"))
    assert [path.name for path in paths] == [
        "ratios.png",
        "scores.png",
        "radii.png",
        "targets-sparse.png",
        "worst-blob.png",
    ]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)
    assert "the worst ratio of 2 scenes" in titles[-1]


def test_without_an_oracle_there_are_no_ratios(population, tmp_path, monkeypatch):
    monkeypatch.setattr(run_figures, "save", lambda _, path: path)
    for name in ("draw_score_curves", "draw_targets"):
        monkeypatch.setattr(population_figures, name, lambda *_: None)
    run_suite(population(estimators=["blob"], snr_db=[0]), tmp_path / "run")
    assert [path.name for path in draw_run(Run.open(tmp_path / "run"))] == [
        "scores.png",
        "radii.png",
        "targets-sparse.png",
    ]
