"""The study of the link: rows of what is sensed and of what is received, and what they hang on."""

import math

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom

from isacbench.bench.kinds.link import (
    LinkKind,
    LinkSuite,
    signal_label,
    signals_of,
)
from isacbench.bench.run.runner import run
from isacbench.bench.suites.suite import Suite
from isacbench.errors import InputError
from isacbench.link.waveform.qam import awgn_ber, bits_per_symbol
from isacbench.model.numerology import prs_elements
from isacbench.model.scenes.scenario import load_scenario
from isacbench.plugins.scoring import Metrics

SHARED = {"name": "test", "estimators": ["blob"], "snr_db": [0, 60], "trials": 2}

DESCRIBED = Metrics().columns(())


@pytest.fixture
def suite(plugins, tiny):
    return LinkSuite(
        **SHARED,
        scenarios=[str(tiny)],
        modulations=["qpsk", "64qam"],
        divisions=["reciprocal", "matched"],
        channels=["awgn", "tapped_delay[profile=tdl_d,delay_spread_s=1e-8]"],
    )


def test_signals_that_yield_the_same_are_sensed_with_once(suite):
    names = ["all-qpsk", "all-64qam-reciprocal", "all-64qam-matched", "prs"]
    assert list(signals_of(suite)) == names


def test_rows_are_those_of_every_signal_and_of_every_channel_modulation_and_receiver(suite, records):
    sensed, received = records[records["channel"] == ""], records[records["channel"] != ""]
    assert set(sensed["scenario"]) == {f"tiny-{name}" for name in signals_of(suite)}
    assert len(sensed) == 4 * 2 * 2
    assert set(sensed["template"]) == {"tiny"}
    assert np.isfinite(sensed["deviation"]).all()
    assert sensed.query("snr_db == 0 and trial == 0")["deviation"].nunique() == 4
    assert len(received) == 2 * 2 * 2 * 2 * 2
    assert set(received["estimator"]) == {"one_tap"}
    assert set(received["modulation"]) == {"qpsk", "64qam"}
    assert received["deviation"].isna().all()
    assert (received["status"] == "ok").all()


def test_the_whole_grid_of_qpsk_is_what_an_ordinary_run_images(records, tiny):
    plain = run(Suite(**SHARED, scenarios=[str(tiny)]))
    linked = records[records["scenario"] == "tiny-all-qpsk"]
    assert linked["deviation"].tolist() == plain["deviation"].tolist()


def test_a_user_gets_all_bits_but_those_of_the_prs_and_errors_as_theory_has_them(records, tiny):
    received = records.query("channel == 'awgn' and params.str.contains('perfect')")
    system = load_scenario(tiny).system
    n_data = system.n_subcarriers * system.n_symbols - int(prs_elements(system).sum())
    for modulation, part in received.groupby("modulation"):
        n_bits = n_data * bits_per_symbol(modulation)
        assert set(part["n_bits"]) == set(part["n_true"]) == {n_bits}
        at_0_db = part[part["snr_db"] == 0]
        rate = float(awgn_ber(modulation, 0.0))
        np.testing.assert_allclose(at_0_db["ber_expected"], rate, rtol=1e-12)
        errors = at_0_db["n_bit_errors"].sum()
        # Bits of one symbol hang together: twice the binomial spread is ample at five of them.
        assert abs(errors - 2 * n_bits * rate) < 10 * math.sqrt(2 * n_bits * rate)
        assert part.loc[part["snr_db"] == 60, "n_bit_errors"].sum() == 0
        np.testing.assert_allclose(at_0_db["evm_db"], 0, atol=0.2)


def test_rates_fall_with_errors_from_what_the_prs_leaves(records):
    received = records.query("channel == 'awgn'")
    best = received[received["snr_db"] == 60].groupby("modulation")["rate_bps"].max()
    assert best["64qam"] == pytest.approx(3 * best["qpsk"])
    worse = received[received["snr_db"] == 0]
    assert (worse["rate_bps"] < worse["modulation"].map(best)).all()


def test_the_summary_pools_bits_and_averages_deviations(records):
    summary = LinkKind().summary(records)
    received = summary.query("channel == 'awgn' and modulation == 'qpsk' and snr_db == 0")
    rows = records.query("channel == 'awgn' and modulation == 'qpsk' and snr_db == 0")
    assert received["n_bits"].sum() == rows["n_bits"].sum()
    assert received[["ber_low", "ber_high"]].isna().all(axis=None)
    often = LinkKind().summary(pd.concat([records] * 3, ignore_index=True)).loc[received.index]
    assert ((often["ber_low"] < received["ber"]) & (received["ber"] < often["ber_high"])).all()
    assert (received["ber"] == received["n_bit_errors"] / received["n_bits"]).all()
    one = summary.query("scenario == 'tiny-prs' and snr_db == 60")
    expected = records.query("scenario == 'tiny-prs' and snr_db == 60")["deviation"].mean()
    assert one["deviation_mean"].item() == pytest.approx(expected)
    assert one["ber"].isna().all()


def test_counts_of_errors_lie_within_the_family_wise_interval_of_the_closed_form(records):
    known = LinkKind().summary(records).query("params.str.contains('perfect') and n_bits > 0")
    assert len(known) == 2 * 2 * 2
    errors = binom(known["n_bits"], known["ber_expected"])
    p_values = 2 * np.minimum(errors.cdf(known["n_bit_errors"]), errors.sf(known["n_bit_errors"] - 1))
    assert (p_values > 0.01 / len(known)).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"channels": ["two_rays"]}, "unknown channel 'two_rays': did you mean 'two_ray'"),
        ({"channels": ["tapped_delay[profile=tdl_z]"]}, "channel tapped_delay: profile = 'tdl_z'"),
        ({"channels": ["awgn", "awgn"]}, "'awgn' is listed twice"),
        ({"receivers": ["two_tap"]}, "unknown receiver 'two_tap': did you mean 'one_tap'"),
        ({"receivers": ["one_tap[knowledge=some]"]}, "receiver one_tap: knowledge = 'some'"),
        ({"modulations": ["8psk"]}, "modulations"),
        ({"channels": ["tapped_delay[delay_spread_s=1e-3]"]}, r"channels: 'tapped_delay\[.*: path at"),
        ({"channels": ["tapped_delay[delay_spread_s=1e-8,speed_mps=1e3]"]}, "channels: .*: Doppler of"),
        ({"receivers": ["one_tap[time_order=9]"]}, r"receivers: 'one_tap\[.*: time_order = 9: allowed is"),
        ({"snr_gain_db": [0.0]}, "takes snr_db"),
    ],
)
def test_a_mistake_is_named(suite, changes, message):
    with pytest.raises(InputError, match=message):
        run(suite.replace(**changes))


def test_scenarios_of_different_systems_are_refused(suite, tiny):
    other, text = tiny.with_name("other.toml"), tiny.read_text().replace('name = "tiny"', 'name = "other"')
    other.write_text(text.replace("n_symbols = 32", "n_symbols = 64"))
    with pytest.raises(InputError, match="'tiny' and 'other' have different systems"):
        run(suite.replace(scenarios=[str(tiny), str(other)]))


def test_a_run_has_a_table_a_signal_and_one_a_receiver(plugins, tiny):
    rows = run(LinkSuite(**SHARED, scenarios=[str(tiny)], channels=["awgn"], modulations=["qpsk", "16qam"]))
    imaged, known, estimated = LinkKind().tables(rows)
    signals = ["all qpsk", "all 16qam reciprocal", "all 16qam matched", "all 16qam wiener", "prs"]
    assert imaged.headings == ["SNR [dB]", *signals]
    assert [row[0] for row in imaged.texts] == ["0", "60"]
    trials = "2 trials, no confidence band below 5"
    assert imaged.title == f"tiny, blob: mean imaging deviation by what is sensed with, {trials}"
    assert not any("±" in text for row in imaged.texts for text in row[1:])
    assert known.title.startswith("awgn, one_tap[knowledge=perfect]: bit error rate")
    assert estimated.title.startswith("awgn, one_tap[knowledge=prs]: bit error rate")
    assert known.texts[1][1].startswith("0 (0) | -60")
    # One trial is no trials, and no decibel has no sign.
    imaged, known, _ = LinkKind().tables(rows.query("trial == 0").assign(evm_db=-0.01))
    assert ", 1 trial, " in imaged.title
    assert known.title.endswith(", 1 frame")
    assert " | 0.0 | " in known.texts[0][1]
    # A suite without users has tables and charts of images alone.
    images = rows[rows["channel"] == ""]
    (table,) = LinkKind().tables(images)
    assert table.headings[1:] == signals
    assert [group.stem for group in LinkKind().charts(images)] == ["link-tiny"]


def drawn(chart):
    """Points of the series of a chart that have a symbol."""
    return {one.label: list(zip(one.x, one.y, strict=True)) for one in chart.series if one.style.symbol}


def test_bit_errors_are_drawn_where_there_are_any_beside_deviations_in_order_of_snr(records):
    summary = LinkKind().summary(records)
    link, _ = LinkKind().charts(records.iloc[::-1])
    charts = {chart.title: chart for chart in link.charts}
    errors, deviations = charts["User behind awgn"], charts["Image by blob"]
    rows = summary.query("channel == 'awgn' and modulation == 'qpsk' and params.str.contains('perfect')")
    (at_0_db, without) = rows.to_dict("records")
    assert without["n_bit_errors"] == 0
    (first, second) = drawn(errors)["qpsk one_tap[knowledge=perfect]"]
    assert first == (0, at_0_db["ber"])
    assert math.isnan(second[1])
    assert len(drawn(errors)) == 4
    expected = {
        signal_label(key): list(zip(part["snr_db"], part["deviation_mean"], strict=True))
        for key, part in summary.query("channel == ''").groupby(["sensing", "modulation", "division"])
    }
    assert drawn(deviations) == expected


def test_the_trade_puts_deviations_over_the_rates_of_the_same_snr(records):
    summary = LinkKind().summary(records).query("snr_db == 0")
    (chart,) = LinkKind().charts(records)[1].charts
    received = summary.query("channel == 'awgn' and params.str.contains('prs')").set_index("modulation")
    imaged = summary.query("channel == ''").set_index("scenario")["deviation_mean"]
    points = [(one.label, [*one.x], [*one.y]) for one in chart.series]
    for modulation, image in (("qpsk", "tiny-all-qpsk"), ("64qam", "tiny-all-64qam-matched")):
        rate_gbps = received.loc[modulation, "rate_bps"] / 1e9
        label = "all qpsk" if modulation == "qpsk" else "all 64qam matched"
        assert (label, [rate_gbps], [imaged[image]]) in points
        # Whatever modulation the data have, the PRS images the same.
        assert (f"prs {modulation}", [rate_gbps], [imaged["tiny-prs"]]) in points
    assert "at 0, 10, 20 and 30 dB" in LinkKind().charts(records)[1].title
