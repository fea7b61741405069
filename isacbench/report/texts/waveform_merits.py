"""The figures of merit of a waveform, for the terminal and as JSON."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.link.waveform.figures_of_merit import OFFSETS, exceeded_papr_db, frame_rates
from isacbench.report.tables.run_tables import Grid

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from isacbench.choices import Modulation
    from isacbench.link.waveform.figures_of_merit import WaveformMerits
    from isacbench.model.numerology import System

    Ratios = Mapping[Modulation, NDArray[np.float64]]

RARE = 1000
"""One in so many symbols is above the peak-to-average power ratio that is told beside the median."""


def waveform_grids(system: System, merits: WaveformMerits, papr_db: Ratios) -> list[Grid]:
    """Tabulate the waveform, what leaves its band, and what it carries in some modulations.

    Parameters
    ----------
    system : System
    merits : WaveformMerits
    papr_db : mapping of str to ndarray
        Ratios of drawn symbols, by modulation.

    Returns
    -------
    list of Grid
    """
    return [
        Grid("waveform", ["what", "value"], _lines(system, merits)),
        Grid(
            "power density beside the band over that inside",
            ["subcarrier spacings beyond", "with suffix [dB]", "without [dB]"],
            [
                [str(offset), f"{windowed:.1f}", f"{plain:.1f}"]
                for offset, windowed, plain in zip(
                    OFFSETS, merits.out_of_band_db, merits.plain_out_of_band_db, strict=True
                )
            ],
        ),
        Grid(
            f"data, and peak-to-average power ratio of {len(next(iter(papr_db.values())))} symbols",
            ["modulation", "bits a frame", "Mbit/s", "median [dB]", f"exceeded by one in {RARE} [dB]"],
            [
                *(_data_row(system, modulation, ratios) for modulation, ratios in papr_db.items()),
                ["theory", "", "", *(f"{value:.2f}" for value in _theory_db(system).values())],
            ],
        ),
    ]


def describe_waveform(system: System, merits: WaveformMerits, papr_db: Ratios) -> dict[str, Any]:
    """Put the same in terms of JSON; parameters as for `waveform_grids`."""
    described = asdict(merits)
    levels_db = zip(
        OFFSETS, described.pop("out_of_band_db"), described.pop("plain_out_of_band_db"), strict=True
    )
    return {
        **described,
        "out_of_band": [
            {"offset_spacings": offset, "level_db": windowed, "without_suffix_db": plain}
            for offset, windowed, plain in levels_db
        ],
        "modulations": {
            modulation: {
                **_carried(system, modulation),
                "papr": {"n_symbols": len(ratios), **_papr_db(ratios)},
            }
            for modulation, ratios in papr_db.items()
        },
        "papr_theory": _theory_db(system),
    }


def _lines(system: System, merits: WaveformMerits) -> list[list[str]]:
    """What a waveform takes, and how much."""
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


def _data_row(system: System, modulation: Modulation, ratios: NDArray[np.float64]) -> list[str]:
    rates = frame_rates(system, modulation)
    told = _papr_db(ratios)
    peaks = ["too few symbols" if value is None else f"{value:.2f}" for value in told.values()]
    return [modulation, str(rates.n_data_bits), f"{rates.bit_rate_bps / 1e6:.1f}", *peaks]


def _carried(system: System, modulation: Modulation) -> dict[str, float]:
    """Data of a frame, for JSON."""
    rates = frame_rates(system, modulation)
    return {"n_data_bits": rates.n_data_bits, "bit_rate_bps": rates.bit_rate_bps}


def _papr_db(ratios: NDArray[np.float64]) -> dict[str, float | None]:
    """Median, and what a rare symbol exceeds, None where so few symbols hold no rare one."""
    n_above = len(ratios) // RARE
    rare_db = float(np.sort(ratios)[-1 - n_above]) if n_above else None
    return {"median_db": float(np.median(ratios)), "rare_db": rare_db}


def _theory_db(system: System) -> dict[str, float]:
    return {
        name: exceeded_papr_db(probability, system.n_subcarriers)
        for name, probability in (("median_db", 0.5), ("rare_db", 1 / RARE))
    }
