"""Echo of a scene as a waveform: received at the array, with noise, and observed through the demodulator.

This module does not use the closed form of the echo on a resource element.
Scatterers are paths of the waveform. The received waveform is demodulated and
divided by the transmitted symbols, and the range-Doppler cells of the gate are
summed symbol by symbol: neither the waveform of all elements nor their resource
grid is ever held in memory.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import scipy.fft

from isacbench.cores import available_cores
from isacbench.dsp.partial_dft import doppler_rows
from isacbench.errors import InputError, InputWarning
from isacbench.link.sensing.division import Signal, division_factors, sensed_elements
from isacbench.link.sensing.interference import echo_interference
from isacbench.link.waveform.ofdm import layout
from isacbench.link.waveform.propagation import Paths, propagate, received_symbols
from isacbench.link.waveform.resource_grid import draw_grid
from isacbench.model.echo import (
    Simulator,
    echo_parameters,
    element_responses,
    is_dust,
    random_stream,
    white_gaussian,
)
from isacbench.model.numerology import SPEED_OF_LIGHT_MPS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import ArrayLike, NDArray

    from isacbench.choices import Division, Modulation, Sensing
    from isacbench.link.waveform.resource_grid import ResourceGrid
    from isacbench.model.gate import Gate
    from isacbench.model.numerology import System
    from isacbench.model.observation import Observation
    from isacbench.model.scene import Scenario

    Complex = NDArray[np.complex128]


def echo_paths(scenario: Scenario, elements: ArrayLike) -> Paths:
    """Make the paths from the base station via every scatterer to elements of the virtual array.

    Parameters
    ----------
    scenario : Scenario
    elements : array_like of int, shape (E, 2)
        Places (p, q) in the virtual array, which ascend towards -u and -w.

    Returns
    -------
    Paths
        One for each scatterer, of delay 2R/c and Doppler 2v f_c/c. Nothing is
        aliased: a delay may exceed a symbol.

    Raises
    ------
    InputError
        If an element is not one of the array.
    """
    places = np.asarray(elements)
    n_p, n_q = scenario.array.shape
    is_place = places.ndim == 2 and places.shape[1] == 2 and places.dtype.kind in "iu"
    if not (is_place and ((places >= 0) & (places < (n_p, n_q))).all()):
        raise InputError(f"elements {elements!r}: allowed are pairs from (0, 0) to ({n_p - 1}, {n_q - 1})")
    echo = echo_parameters(scenario)
    return Paths(
        gain=echo.gain[:, None] * element_responses(scenario, echo, places),
        delay_s=2 * scenario.range_m / SPEED_OF_LIGHT_MPS,
        doppler_hz=2 * scenario.scatterers.velocity * scenario.system.carrier_hz / SPEED_OF_LIGHT_MPS,
    )


def received_waveform(
    scenario: Scenario,
    grid: ResourceGrid,
    elements: ArrayLike,
    snr_db: float = np.inf,
    trial: int = 0,
    seed: int = 0,
) -> Complex:
    """Compute the waveform of a frame (echoes and noise) received at elements of the virtual array.

    Parameters
    ----------
    scenario : Scenario
    grid : ResourceGrid
        The transmitted frame.
    elements : array_like of int, shape (E, 2)
        Places (p, q) in the virtual array.
    snr_db : float
        Signal-to-noise ratio Σ|G|²/σ² per resource element and virtual element;
        infinity for no noise. A sample has the noise power of a resource element.
    trial, seed : int
        Trial and seed of the noise. The noise of an element does not depend on
        the other elements.

    Returns
    -------
    ndarray of complex128, shape (n, E)
        Sampled at the critical rate, from the start of transmission of the first
        prefix to the last echo.

    Raises
    ------
    InputError
        If an element is not one of the array, an echo takes longer than the frame,
        or `propagate` refuses the system or `Simulator.noise_amplitude` the SNR.

    Warns
    -----
    InputWarning
        If echoes arrive when the cyclic prefix has passed.
    """
    scenario.require_default("a waveform", "noise", "mimo", "leakage_db")
    amplitude = Simulator(scenario).noise_amplitude(snr_db)
    paths = echo_paths(scenario, elements)
    _warn_of_interference(scenario)
    waveform = propagate(grid.symbols, scenario.system, paths)
    if amplitude:
        for samples, stream in zip(waveform.T, _noise_streams(scenario, elements, trial, seed), strict=True):
            samples += amplitude * white_gaussian(stream, samples.shape)
    return waveform


def observe_waveform(
    scenario: Scenario,
    snr_db: float,
    trial: int = 0,
    seed: int = 0,
    *,
    modulation: Modulation = "qpsk",
    sensing: Sensing = "all",
    division: Division = "reciprocal",
    n_id: int = 0,
) -> Observation:
    """Observe a scenario through its waveform: modulated, reflected, demodulated and divided.

    Parameters
    ----------
    scenario : Scenario
    snr_db : float
        Signal-to-noise ratio Σ|G|²/σ² per resource element and virtual element;
        infinity for no noise.
    trial, seed : int
        Trial and seed of data and noise. The noise is that of `received_waveform`,
        not the draw of `isacbench.observe`.
    modulation : {"qpsk", "16qam", "64qam", "256qam"}
        Modulation of the data.
    sensing : {"all", "prs"}
        Resource elements used for sensing.
    division : {"reciprocal", "matched", "wiener"}
        How received symbols are divided by transmitted ones.
    n_id : int
        Identity of the PRS sequence.

    Returns
    -------
    Observation
        As of `isacbench.observe`, for any estimator.

    Raises
    ------
    InputError
        If a value is not allowed, or prefix or suffix are not whole samples.

    Warns
    -----
    InputWarning
        If echoes arrive when the cyclic prefix has passed.
    """
    scenario.require_default("an observation through the waveform", "noise", "mimo", "leakage_db")
    simulator, system = Simulator(scenario), scenario.system
    amplitude = simulator.noise_amplitude(snr_db)
    signal = Signal(modulation, sensing, division, n_id)
    grid = draw_grid(system, modulation, trial=trial, seed=seed, n_id=n_id)
    # Constellations have unit mean power; the symbols of one frame only approximately.
    sensed = sensed_elements(system, sensing)
    factors = division_factors(grid.symbols, sensed, signal.division, snr_db, unit=1.0)
    elements = scenario.array.positions
    symbols = received_symbols(grid.symbols, system, echo_paths(scenario, elements))
    _warn_of_interference(scenario)
    if amplitude:
        noise = _noise_symbols(system, _noise_streams(scenario, elements, trial, seed))
        symbols = (echo + amplitude * white for echo, white in zip(symbols, noise, strict=True))
    divided = (received * by[:, None] for received, by in zip(symbols, factors.T, strict=True))
    cells = _gate_cells(divided, simulator.gate, system)
    if not amplitude and is_dust(cells, echo_parameters(scenario), np.sqrt(system.processing_gain)):
        cells[:] = 0
    observation = simulator.observation(cells.reshape(*simulator.gate.shape, *scenario.array.shape))
    return replace(observation, sensing=sensing)


def interference_to_echo_db(scenario: Scenario) -> float:
    """Compute the interference of late echoes on a resource element, over the power of all echoes.

    Late echoes come from beyond the range of the undisturbed cyclic prefix. Their
    interference includes the effect of Doppler within a symbol.

    Parameters
    ----------
    scenario : Scenario

    Returns
    -------
    float
        In dB; -inf where no echo is late.
    """
    scatterers, is_late = scenario.scatterers, scenario.range_m > scenario.system.isi_free_range_m
    unit, power = scatterers.power_in_units
    if power == 0 or not is_late.any():
        return -np.inf
    late = echo_interference(scenario.system, scenario.range_m[is_late], scatterers.velocity[is_late])
    with np.errstate(divide="ignore"):
        share_db = 10 * np.log10(np.sum((scatterers.amplitude[is_late] / unit) ** 2 * late.power) / power)
    return float(share_db)


def _warn_of_interference(scenario: Scenario) -> None:
    limit_m = scenario.system.isi_free_range_m
    is_late = scenario.range_m > limit_m
    if is_late.any():
        beyond_m = scenario.range_m.max() - limit_m
        warnings.warn(
            f"scenario {scenario.name}: echoes of {is_late.sum()} of {is_late.size} scatterers come from "
            f"up to {beyond_m:.1f} m beyond the {limit_m:.1f} m of the undisturbed cyclic prefix; "
            f"their interference is at {interference_to_echo_db(scenario):.1f} dB of all echoes",
            InputWarning,
            stacklevel=3,
        )


def _noise_streams(
    scenario: Scenario, elements: ArrayLike, trial: int, seed: int
) -> list[np.random.Generator]:
    """Random streams of the noise, one for each element."""
    return [
        random_stream(scenario.name, trial, seed, "waveform", str(p), str(q))
        for p, q in np.asarray(elements).tolist()
    ]


def _noise_symbols(system: System, streams: list[np.random.Generator]) -> Iterator[Complex]:
    """Demodulate unit white noise (n_subcarriers, E) of one symbol after the other."""
    parts = layout(system)

    for _ in range(system.n_symbols):
        samples = np.stack(
            [white_gaussian(stream, (parts.n_symbol,))[parts.n_prefix :] for stream in streams]
        )
        yield scipy.fft.fft(samples, axis=1, norm="ortho", workers=available_cores()).T


def _gate_cells(symbols: Iterable[Complex], gate: Gate, system: System) -> Complex:
    """Range-Doppler cells (n_range, n_doppler, E) of divided symbols (n_subcarriers, E)."""
    bins = gate.range_bins % system.n_subcarriers
    at_range = np.stack(
        [scipy.fft.ifft(symbol, axis=0, norm="ortho", workers=available_cores())[bins] for symbol in symbols]
    )
    cells = np.tensordot(doppler_rows(gate.doppler_bins, system.n_symbols), at_range, axes=1)
    return np.ascontiguousarray(cells.swapaxes(0, 1))
