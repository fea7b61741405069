"""The echo: range-Doppler cells of the gate in closed form, and the full resource grid as its reference.

One echo a scatterer, after division by the transmitted symbols, at subcarrier
n, symbol m and virtual element (p, q):

    s[n, m, p, q] = Σ_k G_k exp(-j2π nΔf 2R_k/c) exp(+j2π m T 2v_k f_c/c) exp(-jπ(p u_k + q w_k))

Unitary transforms along n and m turn each exponential into a Dirichlet
kernel, so that only the gate is ever computed.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isacbench.dsp.kernels import dirichlet
from isacbench.model.gate import Gate, build_gate
from isacbench.model.numerology import SPEED_OF_LIGHT_MPS
from isacbench.model.observation import Observation

if TYPE_CHECKING:
    from isacbench.model.scene import Scenario

__all__ = [
    "Simulator",
    "central_phase",
    "clean_echo",
    "observe",
    "random_stream",
    "resource_grid",
    "unit_noise",
    "white_gaussian",
]

Complex = NDArray[np.complex128]

FEW_SPEEDS = 4
"""Echoes a speed from which it pays to sum those of each speed first."""


@dataclass(frozen=True, eq=False)
class _EchoParameters:
    """What the radio sees of every scatterer: gain, fractional bins, direction cosines."""

    gain: Complex
    range_bin: NDArray[np.float64]
    doppler_bin: NDArray[np.float64]
    u: NDArray[np.float64]
    w: NDArray[np.float64]


def _echo_parameters(scenario: Scenario) -> _EchoParameters:
    system, scatterers = scenario.system, scenario.scatterers
    offset_m = scatterers.xyz - scenario.base_station_m
    range_m = np.linalg.norm(offset_m, axis=1)
    gain = scatterers.amplitude * np.exp(1j * scatterers.phase_rad)
    if system.coherent_phase:
        gain = gain * np.exp(-4j * np.pi * system.carrier_hz / SPEED_OF_LIGHT_MPS * range_m)
    u, w = scenario.frame.direction_cosines(offset_m)
    return _EchoParameters(
        gain, range_m / system.range_bin_m, scatterers.velocity / system.velocity_bin_mps, u, w
    )


def central_phase(scenario: Scenario) -> NDArray[np.float64]:
    """Phase of every echo at the centre of the resource grid and of the array.

    Two equal echoes closer than a Rayleigh cell are hardest to tell apart
    where they are in phase there.

    Parameters
    ----------
    scenario : Scenario

    Returns
    -------
    ndarray of float64, shape (n,)
        In radians, from -π to π.
    """
    echo = _echo_parameters(scenario)
    system, (n_p, n_q) = scenario.system, scenario.array.shape
    turns = (system.n_symbols - 1) / system.n_symbols * echo.doppler_bin
    turns -= (system.n_subcarriers - 1) / system.n_subcarriers * echo.range_bin
    turns -= ((n_p - 1) * echo.u + (n_q - 1) * echo.w) / 2
    phase: NDArray[np.float64] = np.angle(echo.gain * np.exp(1j * np.pi * turns))
    return phase


def clean_echo(scenario: Scenario, gate: Gate) -> Complex:
    """Noise-free range-Doppler cells of the gate on every virtual element, in closed form.

    Parameters
    ----------
    scenario : Scenario
    gate : Gate

    Returns
    -------
    ndarray of complex128, shape (n_range, n_doppler, P, Q)
    """
    echo = _echo_parameters(scenario)
    system = scenario.system
    along_range = dirichlet(gate.range_bins, echo.range_bin, system.n_subcarriers)
    along_doppler = dirichlet(gate.doppler_bins, echo.doppler_bin, system.n_symbols).conj()
    n_p, n_q = scenario.array.shape
    directions = _directions(echo, scenario.array.positions)
    cells = _superposed(along_range * echo.gain, along_doppler, directions, echo.doppler_bin)
    return cells.reshape(*gate.shape, n_p, n_q)


def resource_grid(scenario: Scenario, elements: ArrayLike, subcarriers: slice = slice(None)) -> Complex:
    """Noise-free echo on the resource grid.

    Parameters
    ----------
    scenario : Scenario
    elements : array_like of int, shape (e, 2)
        Places (p, q) in the virtual array.
    subcarriers : slice, optional
        Consecutive ones; all of them by default.

    Returns
    -------
    ndarray of complex128, shape (n_subcarriers, n_symbols, e)
    """
    echo = _echo_parameters(scenario)
    system = scenario.system
    n = np.arange(system.n_subcarriers)[subcarriers, None]
    m = np.arange(system.n_symbols)[:, None]
    delay = np.exp(-2j * np.pi * n * echo.range_bin / system.n_subcarriers)
    doppler = np.exp(2j * np.pi * m * echo.doppler_bin / system.n_symbols)
    return _superposed(delay * echo.gain, doppler, _directions(echo, elements), echo.doppler_bin)


def _directions(echo: _EchoParameters, elements: ArrayLike) -> Complex:
    """Responses (K, e) of elements (p, q) to every echo."""
    p, q = np.asarray(elements).T
    directions: Complex = np.exp(-1j * np.pi * (np.outer(echo.u, p) + np.outer(echo.w, q)))
    return directions


def _superposed(
    along_range: Complex, along_doppler: Complex, directions: Complex, doppler_bin: NDArray[np.float64]
) -> Complex:
    """Sum (a, b, e) of echoes that are products (a, K), (b, K) and (K, e).

    Echoes of one speed have one Doppler profile. Where few speeds occur, as
    where rigid objects move, sums over the echoes of each come first.
    """
    (n_range, n_echoes), n_doppler = along_range.shape, len(along_doppler)
    speeds, first, of_speed = np.unique(doppler_bin, return_index=True, return_inverse=True)
    if FEW_SPEEDS * speeds.size < n_echoes:
        at_speed = np.empty((n_range, speeds.size, directions.shape[1]), dtype=np.complex128)
        for k in range(speeds.size):
            at_speed[:, k] = along_range[:, of_speed == k] @ directions[of_speed == k]
        cells: Complex = along_doppler[:, first] @ at_speed
        return cells
    # Explicit sizes, because -1 cannot be resolved where a scene is empty.
    n_cells = n_range * n_doppler
    delay_doppler = (along_range[:, None, :] * along_doppler[None, :, :]).reshape(n_cells, n_echoes)
    return (delay_doppler @ directions).reshape(n_range, n_doppler, directions.shape[1])


def random_stream(scenario_name: str, trial: int, seed: int, *purpose: str) -> np.random.Generator:
    """Random numbers that follow from (scenario, trial, seed) alone; without a purpose they are its noise.

    Parameters
    ----------
    scenario_name : str
    trial, seed : int
        Not negative.
    *purpose : str
        What else is drawn, each with a stream of its own.

    Returns
    -------
    Generator
    """
    keys = [
        int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")
        for text in (scenario_name, *purpose)
    ]
    return np.random.default_rng(np.random.SeedSequence([seed, trial, *keys]))


def unit_noise(scenario_name: str, trial: int, seed: int, shape: tuple[int, ...]) -> Complex:
    """White circular complex Gaussian noise of unit power, a function of (scenario, trial, seed) alone.

    Parameters
    ----------
    scenario_name : str
    trial, seed : int
        Not negative.
    shape : tuple of int
        Shape of the scenario's canonical gate on the virtual array.

    Returns
    -------
    ndarray of complex128
    """
    return white_gaussian(random_stream(scenario_name, trial, seed), shape)


def white_gaussian(stream: np.random.Generator, shape: tuple[int, ...]) -> Complex:
    """White circular complex Gaussian numbers of unit power.

    Parameters
    ----------
    stream : Generator
    shape : tuple of int

    Returns
    -------
    ndarray of complex128
    """
    parts = stream.standard_normal((*shape, 2))
    parts *= np.sqrt(0.5)
    noise: Complex = parts.view(np.complex128)[..., 0]
    return noise


class Simulator:
    """Observations of one scenario: the clean echo is computed once, a trial's noise drawn once.

    Parameters
    ----------
    scenario : Scenario
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.gate = build_gate(scenario.system, scenario.base_station_m, scenario.region)
        self._drawn: tuple[tuple[int, int], Complex] | None = None

    @cached_property
    def clean(self) -> Complex:
        """Noise-free cells (n_range, n_doppler, P, Q)."""
        return clean_echo(self.scenario, self.gate)

    def noise_power(self, snr_db: float) -> float:
        """Noise power σ² per resource element and virtual element.

        The SNR is Σ|G|² / σ²; a scene without echoes counts as one unit
        scatterer.
        """
        echo_power = float(np.sum(self.scenario.scatterers.amplitude**2)) or 1.0
        return float(echo_power * 10 ** (-snr_db / 10))

    def observe(self, snr_db: float, trial: int = 0, seed: int = 0) -> Observation:
        """Observe the scenario once.

        Parameters
        ----------
        snr_db : float
            Signal-to-noise ratio at the receiver, per resource element and
            virtual element; infinity for no noise.
        trial, seed : int
            Which noise. It depends neither on the SNR nor on who looks.

        Returns
        -------
        Observation
        """
        cells = np.sqrt(self.noise_power(snr_db)) * self.unit_noise(trial, seed)
        cells += self.clean
        cells.setflags(write=False)
        scenario = self.scenario
        return Observation(
            cells,
            self.gate,
            scenario.system,
            scenario.array,
            scenario.frame,
            scenario.base_station_m,
            scenario.region,
        )

    def unit_noise(self, trial: int, seed: int) -> Complex:
        """Noise of unit power (n_range, n_doppler, P, Q); the last trial's is kept."""
        if self._drawn is None or self._drawn[0] != (trial, seed):
            shape = (*self.gate.shape, *self.scenario.array.shape)
            self._drawn = (trial, seed), unit_noise(self.scenario.name, trial, seed, shape)
        return self._drawn[1]


def observe(scenario: Scenario, snr_db: float, trial: int = 0, seed: int = 0) -> Observation:
    """Observe a scenario once; the clean echoes of the last two scenarios are kept.

    Parameters
    ----------
    scenario : Scenario
    snr_db : float
        Signal-to-noise ratio Σ|G|²/σ² per resource element and virtual element.
    trial, seed : int
        Which noise.

    Returns
    -------
    Observation

    Examples
    --------
    >>> from isacbench.model.scenario import load_scenario
    >>> observe(load_scenario("street"), snr_db=10).cells.shape[2:]
    (16, 16)
    """
    return _simulator(scenario).observe(snr_db, trial, seed)


@lru_cache(maxsize=2)
def _simulator(scenario: Scenario) -> Simulator:
    return Simulator(scenario)
