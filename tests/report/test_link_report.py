"""Tables and figures of the link, from made-up summaries and from a small run."""

import json
import math

import numpy as np
import pandas as pd

from isacbench.bench.run.runner import run_suite
from isacbench.bench.store.run import Run
from isacbench.bench.suites.link_kind import LinkSuite
from isacbench.report.figures import run_figures
from isacbench.report.figures.link_figures import draw_link, draw_trade
from isacbench.report.figures.run_figures import draw_run
from isacbench.report.tables.link_tables import receiver_labels, signal_label
from isacbench.report.tables.tables_by_kind import grids_of

PARAMS = {name: json.dumps({"knowledge": name, "time_order": 0}) for name in ("perfect", "prs")}
SNRS = [0.0, 10.0, 20.0]


def imaged(signal, deviation):
    sensing, modulation, division = signal
    keys = {"template": "room", "sensing": sensing, "modulation": modulation, "division": division}
    mean = {"deviation_mean": deviation, "deviation_band": 0.5}
    rows = {"estimator": "a", "params": "{}", "channel": "", "n_cells": 5, "snr_db": SNRS}
    return pd.DataFrame({**rows, **keys, **mean})


def received(modulation, knowledge, errors):
    counts = {"n_bits": 1000, "n_bit_errors": errors, "ber": np.array(errors) / 1000}
    band = {"ber_low": counts["ber"] / 2, "ber_high": 2 * counts["ber"], "rate_bps": [1e9, 2e9, 3e9]}
    keys = {"template": "", "sensing": "", "division": "", "channel": "awgn", "modulation": modulation}
    who = {"estimator": "one_tap", "params": PARAMS[knowledge], "n_cells": 5}
    return pd.DataFrame({**who, "snr_db": SNRS, **keys, **counts, **band})


def summary():
    parts = [
        imaged(("all", "qpsk", ""), [4.0, 3.0, 2.0]),
        imaged(("all", "16qam", "matched"), [5.0, 4.0, 3.0]),
        imaged(("prs", "", ""), [9.0, 8.0, 7.0]),
        *(received(modulation, name, [200, 20, 0]) for modulation in ("qpsk", "16qam") for name in PARAMS),
    ]
    # Out of order, as a merged run is.
    return pd.concat(parts).iloc[::-1].reset_index(drop=True)


def test_signals_and_receivers_have_names_for_people():
    assert signal_label(("all", "qpsk", "")) == "QPSK"
    assert signal_label(("all", "64qam", "wiener")) == "64QAM, Wiener"
    assert signal_label(("prs", "", "")) == "PRS alone"
    labels = receiver_labels(pd.concat([received("qpsk", name, [1, 1, 1]) for name in PARAMS]))
    assert list(labels.values()) == ["channel known", "channel from PRS"]


def test_bit_errors_are_drawn_where_there_are_any_above_deviations_in_order_of_snr():
    figure = draw_link(summary(), "room")
    errors, deviations = figure.axes[0], figure.axes[1]
    measured = [line for line in errors.lines if line.get_marker() == "o"]
    assert len(measured) == 4
    for line in measured:
        np.testing.assert_allclose(line.get_xydata(), [[0, 0.2], [10, 0.02]])
    curves = {tuple(line.get_ydata()) for line in deviations.lines}
    assert curves == {(4, 3, 2), (5, 4, 3), (9, 8, 7)}
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert {"QPSK", "16QAM", "image, matched division", "image, PRS alone"} <= set(texts)


def test_the_trade_puts_deviations_over_the_rates_of_the_same_snr():
    figure = draw_trade(summary(), "room")
    (axes,) = figure.axes
    paths = [line.get_xydata().tolist() for line in axes.lines]
    assert [[1, 4], [2, 3], [3, 2]] in paths
    # Whatever modulation the data have, the PRS images the same.
    assert paths.count([[1, 9], [2, 8], [3, 7]]) == 2


def test_without_users_or_without_images_there_is_no_trade_and_the_rest_is_drawn():
    table = summary()
    images, users = table[table["channel"] == ""], table[table["channel"] != ""]
    assert draw_trade(images, "room") is None
    assert draw_trade(users, "room") is None
    assert len(draw_link(images, "room").axes) == 1


def test_a_run_has_a_table_a_signal_and_one_a_receiver_and_two_figures(plugins, tiny, tmp_path):
    suite = {"name": "test", "scenarios": [str(tiny)], "estimators": ["blob"], "channels": ["awgn"]}
    results = run_suite(
        LinkSuite(**suite, modulations=["qpsk", "16qam"], snr_db=[0, 40], trials=2), tmp_path / "run"
    )
    imaged_grid, known, estimated = grids_of(results.rows, "link")
    header = ["SNR [dB]", "QPSK", "16QAM, reciprocal", "16QAM, matched", "16QAM, Wiener", "PRS alone"]
    assert imaged_grid.header == header
    assert [row[0] for row in imaged_grid.rows] == ["0", "40"]
    assert imaged_grid.title.startswith(
        "tiny, blob: mean imaging deviation by what is sensed with, 2 trials, "
        "no confidence interval below 5; median processor time "
    )
    assert not any("±" in cell for row in imaged_grid.rows for cell in row[1:])
    assert known.title.startswith("awgn, channel known: bit error rate")
    assert estimated.title.startswith("awgn, channel from PRS: bit error rate")
    assert known.rows[1][1].startswith("0 (0) | -40")
    assert not math.isnan(results.rows["ber_expected"].max())
    assert {path.name for path in draw_run(Run.open(tmp_path / "run"))} == {"link-tiny.png", "trade-tiny.png"}
    # One trial is no trials, and no decibel has no sign.
    first = results.rows.query("trial == 0").assign(evm_db=-0.01)
    imaged_grid, known, _ = grids_of(first, "link")
    assert ", 1 trial, " in imaged_grid.title
    assert imaged_grid.title.endswith(" ms")
    assert ", 1 frame;" in known.title
    assert " | 0.0 | " in known.rows[0][1]


def test_a_suite_without_users_has_tables_and_a_figure_of_images(plugins, tiny, tmp_path, monkeypatch):
    monkeypatch.setattr(run_figures, "save", lambda _, path: path)
    suite = {"name": "test", "scenarios": [str(tiny)], "estimators": ["blob"], "channels": []}
    results = run_suite(
        LinkSuite(**suite, modulations=["qpsk"], sensing=["all"], snr_db=[40], trials=1), tmp_path / "run"
    )
    (grid,) = grids_of(results.rows, "link")
    assert grid.header == ["SNR [dB]", "QPSK"]
    assert [path.name for path in draw_run(Run.open(tmp_path / "run"))] == ["link-tiny.png"]


def test_snrs_beside_the_points_do_not_cover_each_other():
    # Once all bits arrive, neither the rate nor the image grows any further.
    figure = draw_trade(summary().assign(rate_bps=1e9, deviation_mean=4.0), "room")
    figure.draw_without_rendering()
    for axes in figure.axes:
        boxes = [text.get_window_extent() for text in axes.texts]
        assert len(boxes) == len(SNRS)
        assert not any(one.overlaps(other) for k, one in enumerate(boxes) for other in boxes[:k])


def test_the_legend_of_the_trade_says_what_numbers_are_and_gives_the_prs_no_modulations_colour():
    figure = draw_trade(summary(), "room")
    entries = {line.get_label(): line for line in figure.legends[0].get_lines()}
    assert any("SNR" in label and "dB" in label for label in entries)
    assert entries["image, PRS alone"].get_color() == entries["image, matched division"].get_color()


def test_a_channel_of_many_parameters_has_a_title_as_wide_as_its_panel():
    name = "tapped_delay[profile=tdl_d,delay_spread_s=26e-9,speed_mps=0.2]"
    figure = draw_link(summary().replace({"channel": {"awgn": name}}), "room")
    panel = figure.axes[0]
    assert panel.get_title().replace("\n", " ").endswith(name.replace(",", ", "))
    figure.draw_without_rendering()
    assert panel.title.get_window_extent().width < 1.25 * panel.get_window_extent().width


def test_markers_of_the_trade_are_drawn_whole_where_all_deviations_are_far_above_0():
    figure = draw_trade(summary().assign(deviation_mean=12.0), "room")
    for axes in figure.axes:
        assert axes.get_ylim()[0] == 0
        assert axes.get_ylim()[1] > 1.06 * max(max(line.get_ydata()) for line in axes.lines)
