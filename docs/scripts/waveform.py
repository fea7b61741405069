"""Draw the spectrum and the peaks of the waveform for docs/waveform.md, and print levels beside the band.

python docs/scripts/waveform.py    # a minute
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from isacbench.link.waveform.figures_of_merit import frame_rates, papr_ccdf, symbol_papr_db
from isacbench.link.waveform.ofdm import mean_power, modulate, power_density
from isacbench.link.waveform.qam import BITS
from isacbench.link.waveform.resource_grid import draw_grid
from isacbench.model.numerology import System

IMAGES = Path(__file__).resolve().parents[1] / "images"
SYSTEM = System()
SHAPES = {"with suffix": SYSTEM, "without suffix": replace(SYSTEM, cyclic_suffix_ratio=0.0)}
OVERSAMPLING = 4
SPACINGS = (1, 10, 100, 1000)
"""Subcarrier spacings beyond the edge of the band at which levels are printed."""

N_FRAMES = 45


def relative_db(system: System, density: np.ndarray) -> np.ndarray:
    """Convert a power density to dB over its mean inside the band."""
    return 10 * np.log10(density * system.bandwidth_hz / mean_power(system))


def level_db(system: System, spacings: np.ndarray) -> np.ndarray:
    """Mean density over a subcarrier spacing, so many spacings beyond the edge of the band."""
    place = system.n_subcarriers - 0.5 + np.add.outer(spacings, np.linspace(-0.5, 0.5, 33))
    return relative_db(system, power_density(system, place * system.subcarrier_spacing_hz).mean(axis=-1))


def measured_db(system: System, symbols: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Periodogram of a frame, averaged over a subcarrier spacing: places in spacings, and levels."""
    samples = modulate(symbols, system, OVERSAMPLING)
    rate_hz = OVERSAMPLING * system.bandwidth_hz
    n_each = round(system.subcarrier_spacing_hz * samples.size / rate_hz)
    energy = np.abs(np.fft.fftshift(np.fft.fft(samples))) ** 2
    density = energy[: energy.size // n_each * n_each].reshape(-1, n_each).mean(axis=1)
    density /= rate_hz**2 * system.n_symbols * system.symbol_time_s
    place = np.linspace(-0.5, 0.5, density.size, endpoint=False) * rate_hz / system.subcarrier_spacing_hz
    return place, relative_db(system, density)


def draw_spectrum() -> plt.Figure:
    """Draw the measured spectrum over the closed form, with and without the suffix."""
    figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
    symbols = draw_grid(SYSTEM, "qpsk").symbols
    beyond = np.concatenate([-np.geomspace(SYSTEM.n_subcarriers / 2, 0.5), np.geomspace(0.5, 1000)])
    for k, (label, system) in enumerate(SHAPES.items()):
        place, level = measured_db(system, symbols)
        upper = place > SYSTEM.n_subcarriers / 2
        axes.plot(place[upper], level[upper], f"C{k}", alpha=0.45, label=f"{label}, measured of one frame")
        theory_db = level_db(system, beyond)
        axes.plot(SYSTEM.n_subcarriers - 0.5 + beyond, theory_db, f"C{k}--", label=f"{label}, closed form")
    axes.set(xlabel="frequency from subcarrier 0 [subcarrier spacings]", ylim=(-135, 8))
    axes.set_ylabel("power density over its mean inside the band [dB]")
    axes.grid(True)
    axes.legend()
    return figure


def draw_papr() -> plt.Figure:
    """Draw the share of the symbols with higher peaks, of every modulation and in theory."""
    figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
    for modulation in BITS:
        grids = (draw_grid(SYSTEM, modulation, trial=trial) for trial in range(N_FRAMES))
        papr_db = np.sort(np.concatenate([symbol_papr_db(grid.symbols) for grid in grids]))
        axes.step(papr_db, 1 - np.arange(papr_db.size) / papr_db.size, where="pre", label=modulation)
        rate_mbps = frame_rates(SYSTEM, modulation).bit_rate_bps / 1e6
        rare_db = papr_db[-1 - papr_db.size // 1000]
        print(f"{modulation}: {rate_mbps:.0f} Mbit/s, peaks {np.median(papr_db):.2f} and {rare_db:.2f} dB")
    level = np.linspace(7, 14, 201)
    theories = {True: "Gaussian envelope, crossings", False: "Gaussian samples at the critical rate"}
    for oversampled, label in theories.items():
        ccdf = papr_ccdf(level, SYSTEM.n_subcarriers, oversampled=oversampled)
        axes.plot(level, ccdf, "k--" if oversampled else "k:", label=label)
    axes.set(xlabel="peak-to-average power ratio [dB]", ylabel="share of symbols with higher peaks")
    axes.set(yscale="log", xlim=(7, 14), ylim=(3e-5, 1.3))
    axes.grid(True)
    axes.legend()
    return figure


def main() -> None:
    """Draw both figures."""
    for label, system in SHAPES.items():
        levels = ", ".join(f"{level:.1f}" for level in level_db(system, np.array(SPACINGS, dtype=float)))
        print(f"{label}: {levels} dB at {SPACINGS} subcarrier spacings beyond the band")
    draw_spectrum().savefig(IMAGES / "waveform-spectrum.png", dpi=120)
    draw_papr().savefig(IMAGES / "waveform-papr.png", dpi=120)


if __name__ == "__main__":
    main()
