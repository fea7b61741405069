"""Draw the spectrum and the peaks of the waveform for docs/waveform.md, and print levels beside the band.

python docs/scripts/waveform.py    # a minute
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import scipy.fft

from isacbench.link.waveform.ofdm import modulate
from isacbench.link.waveform.qam import BITS
from isacbench.link.waveform.resource_grid import draw_grid, frame_rates
from isacbench.model.numerology import System

IMAGES = Path(__file__).resolve().parents[1] / "images"
SYSTEM = System()
SHAPES = {"with suffix": SYSTEM, "without suffix": replace(SYSTEM, cyclic_suffix_ratio=0.0)}
OVERSAMPLING = 4
SPACINGS = (1, 10, 100, 1000)
"""Subcarrier spacings beyond the edge of the band at which levels are printed."""

N_FRAMES = 45


def window_spectrum(system: System, frequency_hz: np.ndarray) -> np.ndarray:
    """Fourier transform of the transmit window in s, referred to its middle.

    The window is a rectangle of the symbol time T_OFDM, smoothed by half a sine wave as long as the suffix.
    Its transform is the product of theirs, T_OFDM sinc(f T_OFDM) cos(π f T_CS) / (1 - (2 f T_CS)²).
    """
    suffix_time_s = system.cyclic_suffix_ratio / system.subcarrier_spacing_hz
    place = np.abs(frequency_hz) * suffix_time_s
    # The same as cos(πx) / (1 - 4x²), without its 0/0 at x = 1/2.
    smoothing = np.pi / 2 * np.sinc(0.5 - place) / (1 + 2 * place)
    return system.symbol_time_s * np.sinc(frequency_hz * system.symbol_time_s) * smoothing


def power_density(system: System, frequency_hz: np.ndarray) -> np.ndarray:
    """Power spectral density in 1/Hz of the waveform of independent symbols of unit power.

    Every subcarrier adds the spectrum of the transmit window, S(f) = Σ_n |W(f - n Δf)|² / (N T_OFDM). Van
    Waterschoot et al., "Power spectral density of cyclic prefixed OFDM signals", EURASIP J. Wireless Commun.
    Netw. (2010), have it for a rectangular window.
    """
    density = np.zeros(frequency_hz.shape)
    for subcarrier in range(system.n_subcarriers):
        density += window_spectrum(system, frequency_hz - subcarrier * system.subcarrier_spacing_hz) ** 2
    return density / (system.n_subcarriers * system.symbol_time_s)


def mean_power(system: System) -> float:
    """Mean power of that waveform, 1 - T_CS / (4 T_OFDM): where two symbols overlap, windows sum to 1."""
    return 1 - system.cyclic_suffix_ratio / (4 * (1 + system.cyclic_prefix_ratio))


def symbol_papr_db(symbols: np.ndarray, oversampling: int = OVERSAMPLING) -> np.ndarray:
    """Largest power of the useful part of every OFDM symbol over the mean power of all, in dB.

    At the critical rate peaks between the samples are missed, at 4 times it about 0.05 dB of their height is.
    """
    samples = scipy.fft.ifft(symbols.T, oversampling * len(symbols), axis=1, norm="forward")
    peak = (np.abs(samples) ** 2).max(axis=1) / len(symbols)
    return 10 * np.log10(peak / np.mean(np.abs(symbols) ** 2))


def papr_ccdf(papr_db: np.ndarray, n_subcarriers: int, *, oversampled: bool = True) -> np.ndarray:
    """Probability that the peak-to-average power ratio of a symbol is exceeded, for Gaussian samples.

    At the critical rate the N samples are independent, and one of them exceeds γ with the probability
    1 - (1 - exp(-γ))^N. Of the continuous envelope N √(πγ/3) exp(-γ) upward crossings of a high level γ are
    expected, of a process with a flat spectrum (Rice, Bell Syst. Tech. J. 27, 1948); rare ones are Poisson
    (Ochiai and Imai, IEEE Trans. Commun. 49, 2001).
    """
    power = 10 ** (papr_db / 10)
    if oversampled:
        expected = n_subcarriers * np.sqrt(np.pi / 3 * power) * np.exp(-power)
    else:
        expected = -n_subcarriers * np.log1p(-np.exp(-power))
    return -np.expm1(-expected)


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
