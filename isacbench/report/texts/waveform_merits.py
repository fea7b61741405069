"""Figures of merit of a waveform, for the terminal and as JSON."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.charts import Table, text_table
from isacbench.link.waveform.figures_of_merit import OFFSETS, exceeded_papr_db, frame_rates

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from isacbench.choices import Modulation
    from isacbench.link.waveform.figures_of_merit import WaveformMerits
    from isacbench.model.numerology import System

    Ratios = Mapping[Modulation, NDArray[np.float64]]

RARE = 1000
"""One in so many symbols exceeds the rare peak-to-average power ratio."""


def waveform_grids(system: System, merits: WaveformMerits, papr_db: Ratios) -> list[Table]:
    """Tabulate the waveform, its out-of-band power, and the data that it carries.

    Parameters
    ----------
    system : System
    merits : WaveformMerits
    papr_db : mapping of str to ndarray
        Peak-to-average power ratios of drawn symbols in dB, by modulation.

    Returns
    -------
    list of Table
    """
    described = describe_waveform(system, merits, papr_db)
    levels = [
        [str(level["offset_spacings"]), f"{level['level_db']:.1f}", f"{level['without_suffix_db']:.1f}"]
        for level in described["out_of_band"]
    ]
    data = []
    for modulation, told in described["modulations"].items():
        rate, (n_symbols, *peaks) = f"{told['bit_rate_bps'] / 1e6:.1f}", told["papr"].values()
        written = ["too few symbols" if peak is None else f"{peak:.2f}" for peak in peaks]
        data.append([modulation, str(told["n_data_bits"]), rate, *written])
    theory = [f"{value:.2f}" for value in described["papr_theory"].values()]
    return [
        text_table("waveform", ["quantity", "value"], _lines(system, merits)),
        text_table(
            "power density outside the band over that inside",
            ["subcarrier spacings beyond", "with suffix [dB]", "without [dB]"],
            levels,
        ),
        text_table(
            f"data, and peak-to-average power ratio of {n_symbols} symbols",
            ["modulation", "bits a frame", "Mbit/s", "median [dB]", f"exceeded by one in {RARE} [dB]"],
            [*data, ["theory", "", "", *theory]],
        ),
    ]


def describe_waveform(system: System, merits: WaveformMerits, papr_db: Ratios) -> dict[str, Any]:
    """Describe the same for JSON.

    Parameters
    ----------
    system : System
    merits : WaveformMerits
    papr_db : mapping of str to ndarray
        Peak-to-average power ratios of drawn symbols in dB, by modulation.

    Returns
    -------
    dict
    """
    described = asdict(merits)
    levels_db = zip(
        OFFSETS, described.pop("out_of_band_db"), described.pop("plain_out_of_band_db"), strict=True
    )
    rates = {modulation: frame_rates(system, modulation) for modulation in papr_db}
    return {
        **described,
        "out_of_band": [
            {"offset_spacings": offset, "level_db": windowed, "without_suffix_db": plain}
            for offset, windowed, plain in levels_db
        ],
        "modulations": {
            modulation: {
                "n_data_bits": rates[modulation].n_data_bits,
                "bit_rate_bps": rates[modulation].bit_rate_bps,
                "papr": {"n_symbols": len(ratios), **_papr_db(ratios)},
            }
            for modulation, ratios in papr_db.items()
        },
        "papr_theory": {
            "median_db": exceeded_papr_db(0.5, system.n_subcarriers),
            "rare_db": exceeded_papr_db(1 / RARE, system.n_subcarriers),
        },
    }


def _lines(system: System, merits: WaveformMerits) -> list[list[str]]:
    """List the quantities of a waveform and their values."""
    parts = merits.layout
    occupied = merits.occupied_bandwidth_hz / system.bandwidth_hz
    return [
        ["sampling rate", f"{merits.sampling_rate_hz / 1e6:.6g} MHz"],
        ["frame", f"{system.n_symbols} symbols, {1e3 * merits.frame_duration_s:.4g} ms"],
        ["symbol", f"{1e6 * merits.symbol_time_s:.4g} µs, {parts.n_symbol} samples"],
        ["prefix", f"{1e9 * merits.prefix_s:.4g} ns, {parts.n_prefix} samples"],
        ["suffix", f"{1e9 * merits.suffix_s:.4g} ns, {parts.n_suffix} samples"],
        ["range without interference", f"{merits.isi_free_range_m:.1f} m"],
        ["share of the PRS", f"{100 * merits.prs_share:.2f} %"],
        [
            "bandwidth with 99 % of the power",
            f"{merits.occupied_bandwidth_hz / 1e6:.6g} MHz, {occupied:.4f} of N Δf",
        ],
    ]


def _papr_db(ratios: NDArray[np.float64]) -> dict[str, float | None]:
    """Compute the median and the ratio that a rare symbol exceeds, None of too few symbols."""
    n_above = len(ratios) // RARE
    rare_db = float(np.sort(ratios)[-1 - n_above]) if n_above else None
    return {"median_db": float(np.median(ratios)), "rare_db": rare_db}
