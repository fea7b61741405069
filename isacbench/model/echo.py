"""The echo: range-Doppler cells of the gate in closed form, and the full resource grid as its reference.

One echo a scatterer, after division by the transmitted symbols, at subcarrier
n, symbol m and virtual element (p, q):

    s[n, m, p, q] = Σ_k G_k exp(-j2π nΔf 2R_k/c) exp(+j2π m T 2v_k f_c/c) exp(-jπ(p u_k + q w_k))

Elements ascend towards -u and -w (`isacbench.model.array`).
Unitary transforms along n and m turn each exponential into a Dirichlet
kernel, so that only the gate is ever computed.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike

from isacbench.checked_arrays import Complex, Floats, parts_of
from isacbench.cores import one_blas_thread
from isacbench.errors import require
from isacbench.model.array import VirtualArray, element_errors
from isacbench.model.gate import Gate, build_gate
from isacbench.model.kernels import dirichlet
from isacbench.model.number_limits import LARGEST_NOISE_AMPLITUDE
from isacbench.model.numerology import SPEED_OF_LIGHT_MPS
from isacbench.model.observation import Observation
from isacbench.model.scene import Scenario
from isacbench.model.scenes.raw_uniforms import raw_uniforms

FEW_SPEEDS = 4
"""Echoes a speed from which it pays to sum those of each speed first."""

NEGLIGIBLE_ROUNDINGS = 16.0
"""Roundings of the largest value that echoes could have together, up to which their sum counts as zero."""

MOST_PRODUCTS = 2**24
"""Products of one echo and one cell held at a time: 256 MB."""


LEAKAGE_BIN = 0.5
"""Range of the transmitters' direct path in bins: between two, where its sidelobes are highest."""


@dataclass(frozen=True, eq=False)
class EchoParameters:
    """Gain, place in the map and direction of every echo.

    Attributes
    ----------
    gain : ndarray of complex128, shape (K,)
        Amplitude, and phase with that of the carrier.
    range_bin, doppler_bin : ndarray of float64, shape (K,)
        Fractional, folded into the map.
    u, w : ndarray of float64, shape (K,)
        Direction cosines.
    """

    gain: Complex
    range_bin: Floats
    doppler_bin: Floats
    u: Floats
    w: Floats


def echo_parameters(scenario: Scenario) -> EchoParameters:
    """Compute gain, fractional bins and direction cosines of every echo."""
    system, scatterers = scenario.system, scenario.scatterers
    offset_m = scatterers.xyz - scenario.base_station_m
    range_m = np.linalg.norm(offset_m, axis=1)
    gain = scatterers.amplitude * np.exp(1j * scatterers.phase_rad)
    if system.coherent_phase:
        gain = gain * np.exp(-4j * np.pi * system.carrier_hz / SPEED_OF_LIGHT_MPS * range_m)
    u, w = scenario.frame.direction_cosines(offset_m)
    # Folded once, here, so that no phase of whole turns costs digits later.
    range_bin = np.mod(range_m / system.range_bin_m, system.n_subcarriers)
    doppler_bin = scatterers.velocity / system.velocity_bin_mps
    doppler_bin = doppler_bin - system.n_symbols * np.rint(doppler_bin / system.n_symbols)
    return EchoParameters(gain, range_bin, doppler_bin, u, w)


def central_phase(scenario: Scenario) -> Floats:
    """Phase of every echo, from -π to π, at the centre of the resource grid and of the array.

    Two equal echoes closer than a Rayleigh cell are hardest to tell apart where they are in phase there.
    """
    echo = echo_parameters(scenario)
    system, (n_p, n_q) = scenario.system, scenario.array.shape
    turns = (system.n_symbols - 1) / system.n_symbols * echo.doppler_bin
    turns -= (system.n_subcarriers - 1) / system.n_subcarriers * echo.range_bin
    turns -= ((n_p - 1) * echo.u + (n_q - 1) * echo.w) / 2
    return np.angle(echo.gain * np.exp(1j * np.pi * turns))


def clean_echo(scenario: Scenario, gate: Gate) -> Complex:
    """Noise-free range-Doppler cells of the gate on every virtual element, in closed form.

    Returns
    -------
    ndarray of complex128, shape (n_range, n_doppler, P, Q)
    """
    system, array = scenario.system, scenario.array
    echo, directions = echo_responses(scenario, array.positions)
    parts = []
    for n, m, own in array.shares:
        along_range = dirichlet(gate.range_bins, echo.range_bin, system.n_subcarriers, n.step, n.start)
        along_doppler = dirichlet(gate.doppler_bins, echo.doppler_bin, system.n_symbols, m.step, m.start)
        parts.append(
            _superposed(along_range * echo.gain, along_doppler.conj(), directions[:, own], echo.doppler_bin)
        )
    cells = _joined(array, parts)
    if is_negligible(cells, echo, np.sqrt(system.processing_gain)):
        cells[:] = 0
    return cells.reshape(*gate.shape, *array.shape)


def _joined(array: VirtualArray, parts: list[Complex]) -> Complex:
    """Join the elements (..., e) of the shares of an array in its own order."""
    if len(parts) == 1:
        return parts[0]
    by_transmitter = np.argsort(array.transmitters, kind="stable")
    return np.concatenate(parts, axis=-1)[..., np.argsort(by_transmitter)]


def resource_grid(scenario: Scenario, elements: ArrayLike, subcarriers: slice = slice(None)) -> Complex:
    """Noise-free echo on the resource grid.

    Parameters
    ----------
    elements : array_like of int, shape (e, 2)
        Places (p, q) in the virtual array.
    subcarriers : slice, optional
        Consecutive ones; all of them by default.

    Returns
    -------
    ndarray of complex128, shape (n_subcarriers, n_symbols, e)
        0 where the transmitter of an element is silent.
    """
    system, array = scenario.system, scenario.array
    echo, directions = echo_responses(scenario, elements)
    n = np.arange(system.n_subcarriers)[subcarriers, None]
    m = np.arange(system.n_symbols)[:, None]
    delay = np.exp(-2j * np.pi * n * echo.range_bin / system.n_subcarriers)
    doppler = np.exp(2j * np.pi * m * echo.doppler_bin / system.n_symbols)
    grid = _superposed(delay * echo.gain, doppler, directions, echo.doppler_bin)
    if is_negligible(grid, echo, 1.0):
        grid[:] = 0
    if array.n_turns > 1:
        transmitter = array.transmitters.reshape(array.shape)[tuple(np.transpose(elements))]
        every_n, every_m = array.thinning
        grid *= ((n[:, :, None] - transmitter) % every_n == 0) & ((m - transmitter) % every_m == 0)
    return grid


def is_negligible(values: Complex, echo: EchoParameters, largest: float) -> bool:
    """Tell if superposed echoes are nothing but the rounding of echoes that cancel.

    Without noise an estimator sees nothing else, and would image it.

    Parameters
    ----------
    values : ndarray of complex128, shape (a, b, e)
    largest : float
        Largest value of a unit echo.
    """
    rounding = NEGLIGIBLE_ROUNDINGS * np.finfo(np.float64).eps * largest * float(np.abs(echo.gain).sum())
    # Mostly the first element tells, at little cost.
    parts = (values[:, :, :1], values)
    return all(float(np.abs(part).max(initial=0)) <= rounding for part in parts)


def element_responses(scenario: Scenario, echo: EchoParameters, elements: ArrayLike) -> Complex:
    """Responses (K, e) of elements (e, 2) to every echo, errors of gain and phase included."""
    p, q = np.asarray(elements).T
    directions: Complex = np.exp(-1j * np.pi * (np.outer(echo.u, p) + np.outer(echo.w, q)))
    if scenario.gain_error_db or scenario.phase_error_deg:
        directions *= element_errors(
            scenario.name, scenario.gain_error_db, scenario.phase_error_deg, np.asarray(elements)
        )
    return directions


def echo_responses(scenario: Scenario, elements: ArrayLike) -> tuple[EchoParameters, Complex]:
    """Compute all K echoes and the responses (K, e) of elements (e, 2) to them.

    The transmitters' leakage, if any, is the last: it has no speed and no direction, and half a range bin,
    and its phases differ from element to element.
    """
    echo, leakage_db = echo_parameters(scenario), scenario.array.leakage_db
    responses = element_responses(scenario, echo, elements)
    if leakage_db is None:
        return echo, responses
    gain = 10 ** (leakage_db / 20) * (scenario.scatterers.total_amplitude or 1.0)
    leakage = gain, LEAKAGE_BIN, 0.0, 0.0, 0.0
    echo = EchoParameters(
        *(
            np.append(getattr(echo, field.name), last)
            for field, last in zip(fields(echo), leakage, strict=True)
        )
    )
    places = np.asarray(elements).tolist()
    turns = [raw_uniforms(f"leakage {p} {q} of {scenario.name}", 1) for p, q in places]
    phases = np.exp(2j * np.pi * np.reshape(turns, (1, -1)))
    return echo, np.concatenate([responses, phases])


def _superposed(
    along_range: Complex, along_doppler: Complex, directions: Complex, doppler_bin: Floats
) -> Complex:
    """Sum (a, b, e) of echoes that are products (a, K), (b, K) and (K, e).

    Echoes of one speed have one Doppler profile. Where few speeds occur, as
    where rigid objects move, sums over the echoes of each come first. Of large
    scenes some rows are summed after the others, for the sake of memory.
    """
    (n_range, n_echoes), n_doppler, n_elements = along_range.shape, len(along_doppler), directions.shape[1]
    speeds, first, of_speed = np.unique(doppler_bin, return_index=True, return_inverse=True)
    by_speed = FEW_SPEEDS * speeds.size < n_echoes

    def rows_superposed(rows: Complex) -> Complex:
        if by_speed:
            at_speed = np.empty((len(rows), speeds.size, n_elements), dtype=np.complex128)
            for k in range(speeds.size):
                at_speed[:, k] = rows[:, of_speed == k] @ directions[of_speed == k]
            return along_doppler[:, first] @ at_speed
        # Explicit sizes, because -1 cannot be resolved where a scene is empty.
        n_cells = len(rows) * n_doppler
        delay_doppler = (rows[:, None, :] * along_doppler[None, :, :]).reshape(n_cells, n_echoes)
        return (delay_doppler @ directions).reshape(len(rows), n_doppler, n_elements)

    products_a_row = speeds.size * n_elements if by_speed else n_doppler * n_echoes
    n_together = MOST_PRODUCTS // max(products_a_row, 1)
    if n_together >= n_range:
        return rows_superposed(along_range)
    superposed = np.empty((n_range, n_doppler, n_elements), dtype=np.complex128)
    for some in parts_of(n_range, n_together):
        superposed[some] = rows_superposed(along_range[some])
    return superposed


def transmitted_noise(scenario: Scenario, trial: int, seed: int) -> Complex:
    """Draw noise of the transmitted signal, over that signal and the root of the power of all echoes.

    White and circular: the paper's noise is real in time, but its transform is divided by QPSK symbols.
    """
    stream = random_stream(scenario.name, trial, seed, "transmitter")
    white = white_gaussian(stream, (scenario.system.n_subcarriers, scenario.system.n_symbols))
    return white / (scenario.scatterers.total_amplitude or 1.0)


def _echoed_noise(scenario: Scenario, gate: Gate, noise: Complex) -> Complex:
    """Cells (n_range, n_doppler, P, Q) of noise (n_subcarriers, n_symbols) that is a factor on every echo."""
    array = scenario.array
    echo, directions = echo_responses(scenario, array.positions)
    directions = echo.gain[:, None] * directions
    parts = []
    for n, m, own in array.shares:
        sent = np.zeros_like(noise)
        sent[n, m] = np.sqrt(array.n_turns) * noise[n, m]
        parts.append(_times_noise(echo, gate, sent, directions[:, own]))
    return _joined(array, parts).reshape(*gate.shape, *array.shape)


def _times_noise(echo: EchoParameters, gate: Gate, noise: Complex, directions: Complex) -> Complex:
    """Cells (n_range * n_doppler, e) of echoes (K, e) times noise.

    Echoes of one speed share the Doppler bins of the noise; each has range bins of its own.
    """
    n_subcarriers, n_symbols = noise.shape
    subcarriers, symbols = np.arange(n_subcarriers), np.arange(n_symbols)

    @lru_cache(maxsize=1)
    def lines(doppler_bin: float) -> Complex:
        shift = np.outer(doppler_bin - gate.doppler_bins, symbols)
        return np.exp(2j * np.pi / n_symbols * shift) @ noise.T / np.sqrt(n_symbols)

    def profile(k: int) -> Complex:
        delay = np.exp(-2j * np.pi / n_subcarriers * echo.range_bin[k] * subcarriers)
        at_range = np.fft.ifft(lines(echo.doppler_bin[k]) * delay, norm="ortho")
        return at_range[:, gate.range_bins % n_subcarriers].T.ravel()

    n_cells, by_speed = gate.shape[0] * gate.shape[1], np.argsort(echo.doppler_bin)
    cells = np.zeros((n_cells, directions.shape[1]), dtype=np.complex128)
    for some in parts_of(by_speed.size, MOST_PRODUCTS // n_cells):
        echoes = by_speed[some]
        cells += np.stack([profile(k) for k in echoes], axis=1) @ directions[echoes]
    return cells


def random_stream(scenario_name: str, trial: int, seed: int, *purpose: str) -> np.random.Generator:
    """Random numbers that follow from (scenario, trial, seed) alone; without a purpose they are its noise.

    Parameters
    ----------
    trial, seed : int
        Not negative.
    *purpose : str
        Name of another draw, each with a stream of its own.

    Raises
    ------
    InputError
        If trial or seed is no whole number, or negative.
    """
    for name, value in (("trial", trial), ("seed", seed)):
        is_whole = isinstance(value, int | np.integer)
        require(is_whole and value >= 0, name, value, "a whole number of 0 and more")
    keys = [
        int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")
        for text in (scenario_name, *purpose)
    ]
    return np.random.default_rng(np.random.SeedSequence([seed, trial, *keys]))


def unit_noise(scenario_name: str, trial: int, seed: int, shape: tuple[int, ...]) -> Complex:
    """White circular complex Gaussian noise of unit power, a function of (scenario, trial, seed) alone.

    Parameters
    ----------
    trial, seed : int
        Not negative.
    shape : tuple of int
        Shape of the scenario's canonical gate on the virtual array.
    """
    return white_gaussian(random_stream(scenario_name, trial, seed), shape)


def white_gaussian(stream: np.random.Generator, shape: tuple[int, ...]) -> Complex:
    """White circular complex Gaussian numbers of unit power."""
    parts = stream.standard_normal((*shape, 2))
    parts *= np.sqrt(0.5)
    return parts.view(np.complex128)[..., 0]


class Simulator:
    """Observations of one scenario: the clean echo is computed once, a trial's noise drawn once."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.gate = build_gate(
            scenario.system, scenario.base_station_m, scenario.region, scenario.array.thinning
        )
        self._drawn: tuple[tuple[int, int], Complex] | None = None

    @cached_property
    def clean(self) -> Complex:
        """Noise-free cells (n_range, n_doppler, P, Q)."""
        return clean_echo(self.scenario, self.gate)

    def noise_power(self, snr_db: float) -> float:
        """Noise power in a cell of a virtual element: σ² of a resource element.

        Where transmitters take turns, it is as many times σ² as there are:
        echoes keep their peaks, though an element sums fewer resource elements.
        The SNR is Σ|G|² / σ²; a scene without echoes, and one with a link budget, counts as
        one unit scatterer. Noise of the transmitter has this power as the sum over
        echoes, each on its own.
        """
        return self.noise_amplitude(snr_db) ** 2

    def noise_amplitude(self, snr_db: float) -> float:
        """Root σ of `noise_power`, which does not underflow as its square does.

        Raises
        ------
        InputError
            If the SNR is no number, or the noise would be too strong.
        """
        unit, power = self.scenario.reference_power
        lowest_db = 10 * np.log10(power) - 20 * np.log10(LARGEST_NOISE_AMPLITUDE / unit)
        limits = f"{lowest_db:.0f} and more, infinity for no noise"
        require(isinstance(snr_db, Real) and snr_db >= lowest_db, "snr_db", snr_db, limits)
        return unit * float(np.sqrt(self.scenario.array.n_turns * power * 10 ** (-float(snr_db) / 10)))

    @one_blas_thread()
    def observe(self, snr_db: float, trial: int = 0, seed: int = 0) -> Observation:
        """Observe the scenario once.

        Parameters
        ----------
        snr_db : float
            Signal-to-noise ratio at the receiver, per resource element and
            virtual element, or that of the transmitted signal where it
            carries the noise; infinity for no noise.
        trial, seed : int
            Which noise. It depends neither on the SNR nor on who looks.

        Raises
        ------
        InputError
            If the SNR is no number, or so low that the noise overflows.
        """
        noise_amplitude = self.noise_amplitude(snr_db)
        if noise_amplitude:
            cells = noise_amplitude * self.unit_noise(trial, seed)
            cells += self.clean
        else:
            cells = self.clean.copy()
        return self.observation(cells)

    def observation(self, cells: Complex) -> Observation:
        """Make an observation of cells, which are read-only from now on.

        Parameters
        ----------
        cells : ndarray of complex128, shape (n_range, n_doppler, P, Q)
        """
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
        """Noise of unit power; the last trial's is kept.

        Returns
        -------
        ndarray of complex128, shape (n_range, n_doppler, P, Q)
        """
        # Looked at once: another thread may put its trial there meanwhile.
        drawn = self._drawn
        if drawn is None or drawn[0] != (trial, seed):
            scenario = self.scenario
            if scenario.system.noise == "transmitter":
                noise = _echoed_noise(scenario, self.gate, transmitted_noise(scenario, trial, seed))
            else:
                shape = (*self.gate.shape, *scenario.array.shape)
                noise = unit_noise(scenario.name, trial, seed, shape)
            drawn = self._drawn = (trial, seed), noise
        return drawn[1]


_simulator = lru_cache(maxsize=2)(Simulator)


def observe_echo(scenario: Scenario, snr_db: float, trial: int = 0, seed: int = 0) -> Observation:
    """Observe a scenario once; the clean echoes of the last two scenarios are kept.

    Parameters
    ----------
    snr_db : float
        Signal-to-noise ratio Σ|G|²/σ² per resource element and virtual element;
        infinity for no noise.
    trial, seed : int
        Which noise.

    Raises
    ------
    InputError
        If the SNR is no number, or so low that the noise overflows.
    """
    return _simulator(scenario).observe(snr_db, trial, seed)
