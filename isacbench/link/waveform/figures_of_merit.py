"""Figures of merit of the waveform: time, band and peaks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from isacbench.link.waveform.ofdm import SymbolLayout, layout
from isacbench.link.waveform.papr import symbol_papr_db
from isacbench.link.waveform.power_spectrum import occupied_bandwidth_hz, out_of_band_db
from isacbench.link.waveform.resource_grid import draw_grid
from isacbench.model.number_limits import require_count
from isacbench.model.prs import prs_elements

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from isacbench.choices import Modulation
    from isacbench.model.numerology import System

OFFSETS = (1, 10, 100, 1000)
"""Subcarrier spacings beyond the edge of the band at which out-of-band levels are given."""


@dataclass(frozen=True)
class WaveformMerits:
    """Figures of merit of a waveform that do not depend on its data.

    Attributes
    ----------
    layout : SymbolLayout
        Samples of a symbol at the critical rate.
    sampling_rate_hz : float
        Critical rate N Δf.
    symbol_time_s, prefix_s, suffix_s : float
        Symbol with its prefix, and parts of it.
    frame_duration_s : float
        From the start of a frame to that of the next.
    isi_free_range_m : float
        Range up to which echoes stay inside the undisturbed prefix.
    prs_share : float
        Share of the resource elements that carry the PRS.
    occupied_bandwidth_hz : float
        Bandwidth with 99 % of the power.
    out_of_band_db : tuple of float
        Power density outside the band over that inside, in dB, at `OFFSETS`.
    plain_out_of_band_db : tuple of float
        The same of a waveform without a suffix.
    """

    layout: SymbolLayout
    sampling_rate_hz: float
    symbol_time_s: float
    prefix_s: float
    suffix_s: float
    frame_duration_s: float
    isi_free_range_m: float
    prs_share: float
    occupied_bandwidth_hz: float
    out_of_band_db: tuple[float, ...]
    plain_out_of_band_db: tuple[float, ...]


def waveform_merits(system: System) -> WaveformMerits:
    """Compute the figures of merit of a waveform in closed form.

    Parameters
    ----------
    system : System

    Returns
    -------
    WaveformMerits

    Raises
    ------
    InputError
        If prefix or suffix are no whole number of samples.
    """
    parts = layout(system)
    offsets_hz = system.subcarrier_spacing_hz * np.array(OFFSETS)
    return WaveformMerits(
        layout=parts,
        sampling_rate_hz=system.bandwidth_hz,
        symbol_time_s=system.symbol_time_s,
        prefix_s=system.cyclic_prefix_ratio / system.subcarrier_spacing_hz,
        suffix_s=system.cyclic_suffix_ratio / system.subcarrier_spacing_hz,
        frame_duration_s=system.n_symbols * system.symbol_time_s,
        isi_free_range_m=system.isi_free_range_m,
        prs_share=float(prs_elements(system).mean()),
        occupied_bandwidth_hz=occupied_bandwidth_hz(system),
        out_of_band_db=tuple(out_of_band_db(system, offsets_hz).tolist()),
        plain_out_of_band_db=tuple(out_of_band_db(without_suffix(system), offsets_hz).tolist()),
    )


def draw_papr_db(
    system: System,
    modulation: Modulation,
    n_frames: int,
    *,
    seed: int = 0,
    drawn: Callable[[], object] | None = None,
) -> NDArray[np.float64]:
    """Draw frames, and measure the peak-to-average power ratios of their symbols.

    They are sampled at four times the critical rate.

    Parameters
    ----------
    system : System
    modulation : {"qpsk", "16qam", "64qam", "256qam"}
        Of the data; the PRS lies between it.
    n_frames : int
    seed : int
        Seed of the data, not negative.
    drawn : callable, optional
        Called after every frame.

    Returns
    -------
    ndarray of float64, shape (n_frames * n_symbols,)

    Raises
    ------
    InputError
        If a value is not allowed.
    """
    require_count("n_frames", n_frames)
    papr_db = []
    for trial in range(n_frames):
        papr_db.append(symbol_papr_db(draw_grid(system, modulation, trial=trial, seed=seed).symbols))
        if drawn is not None:
            drawn()
    return np.concatenate(papr_db)


def without_suffix(system: System) -> System:
    """Leave the suffix, and with it the smooth window, out of a system.

    Parameters
    ----------
    system : System

    Returns
    -------
    System
    """
    return replace(system, cyclic_suffix_ratio=0.0)
