"""Observations through a link: sensing with a part of the grid, and with symbols of unequal power.

Echoes of one speed share a Doppler profile, and weights a[n, m] then act on
every subcarrier by one number a Doppler bin and speed:

    A_v[n, d] = Σ_m F[d, m] exp(j2π m T f_v) a[n, m].

What remains is a sum over speeds and a transform over subcarriers. Directions
of a region span few of the dimensions that an array has: sums are taken over
these, and only the cells of the gate are spread over the elements.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from isacbench.checked_arrays import Complex, Floats, parts_of
from isacbench.cores import one_blas_thread
from isacbench.dsp.partial_dft import doppler_rows, range_bins_by_fft
from isacbench.link.sensing.division import Signal, Weights, division_weights, symbol_moduli
from isacbench.link.sensing.noise_colouring import coloured_noise
from isacbench.model.echo import EchoParameters, Simulator, echo_responses, is_negligible, random_stream
from isacbench.model.gate import Gate
from isacbench.model.observation import Observation
from isacbench.model.scene import Scenario

MOST_NUMBERS = 2**23
"""Complex numbers of an intermediate array that are held at a time: 128 MB."""

ROUNDINGS = 32.0
"""Roundings of the largest singular value below which a dimension of the directions is rounding."""

PLAIN = Signal()


def weighted_echo(scenario: Scenario, gate: Gate, weight: Floats) -> Complex:
    """Compute the noise-free cells of the gate behind weights, 0 or more, of all resource elements."""
    system = scenario.system
    echo, responses = echo_responses(scenario, scenario.array.positions)
    coordinates, basis = _dimensions(responses)
    at_dimensions = _cells(echo, gate, weight, coordinates)
    # Explicit sizes, because -1 cannot be resolved where a scene is empty.
    n_cells, (n_dimensions, n_elements) = gate.shape[0] * gate.shape[1], basis.shape
    cells: Complex = at_dimensions.reshape(n_cells, n_dimensions) @ basis
    cells = cells.reshape(*gate.shape, n_elements)
    if is_negligible(cells, echo, float(weight.sum()) / np.sqrt(system.processing_gain)):
        cells[:] = 0
    return cells.reshape(*gate.shape, *scenario.array.shape)


def _dimensions(responses: Complex) -> tuple[Complex, Complex]:
    """Coordinates (K, k) of responses (K, e) in an orthonormal basis (k, e) of what they span."""
    left, singular, basis = np.linalg.svd(responses, full_matrices=False)
    rank = int((singular > ROUNDINGS * np.finfo(np.float64).eps * singular.max(initial=0)).sum())
    return left[:, :rank] * singular[:rank], basis[:rank]


def _cells(echo: EchoParameters, gate: Gate, weight: Floats, coordinates: Complex) -> Complex:
    """Cells (n_range, n_doppler, k) of echoes whose responses have k coordinates."""
    (n_range, n_doppler), n_subcarriers, n_dimensions = gate.shape, len(weight), coordinates.shape[1]
    cells = np.empty((n_range, n_doppler, n_dimensions), dtype=np.complex128)
    # Whole lines of subcarriers are held, of as many dimensions as memory allows.
    for some in parts_of(n_dimensions, MOST_NUMBERS // (n_subcarriers * n_doppler)):
        lines = _doppler_lines(echo, gate, weight, coordinates[:, some])
        cells[:, :, some] = range_bins_by_fft(lines, gate.range_bins)
    return cells


def _doppler_lines(echo: EchoParameters, gate: Gate, weight: Floats, coordinates: Complex) -> Complex:
    """Doppler bins (n_subcarriers, n_doppler, k) of all subcarriers, a few of them at a time."""
    n_subcarriers, n_symbols = weight.shape
    speeds, of_speed = np.unique(echo.doppler_bin, return_inverse=True)
    symbols = np.arange(n_symbols)
    profiles = np.exp(2j * np.pi * np.outer(speeds, symbols) / n_symbols)
    rows = doppler_rows(gate.doppler_bins, n_symbols)
    # The weights are real: half the operations.
    columns = (rows[:, None] * profiles).reshape(-1, n_symbols).T.copy().view(np.float64)
    amplitudes = echo.gain[:, None] * coordinates
    echoes_of = [np.flatnonzero(of_speed == k) for k in range(speeds.size)]
    lines = np.empty((n_subcarriers, len(rows), coordinates.shape[1]), dtype=np.complex128)
    largest = max(speeds.size * max(coordinates.shape[1], len(rows)), len(echo.gain), 1)
    for part in parts_of(n_subcarriers, MOST_NUMBERS // largest):
        subcarriers = np.arange(part.start, part.stop)
        profile = (weight[part] @ columns).view(np.complex128).reshape(-1, len(rows), speeds.size)
        at_speed = np.empty((subcarriers.size, speeds.size, coordinates.shape[1]), dtype=np.complex128)
        for k, echoes in enumerate(echoes_of):
            delays = np.exp(-2j * np.pi / n_subcarriers * np.outer(subcarriers, echo.range_bin[echoes]))
            at_speed[:, k] = delays @ amplitudes[echoes]
        lines[part] = profile @ at_speed
    return lines


class SignalSimulator(Simulator):
    """Observations of one scenario that is illuminated by a signal.

    What does not change from trial to trial, or from SNR to SNR, is computed
    once. `clean` and `unit_noise` are those of the whole grid with symbols of
    unit modulus.

    Parameters
    ----------
    signal : Signal, optional
        QPSK on the whole grid unless given.
    """

    def __init__(self, scenario: Scenario, signal: Signal = PLAIN) -> None:
        super().__init__(scenario)
        self.signal = signal
        if not signal.is_plain:
            scenario.require_default("the PRS alone and unequal symbols", "noise", "mimo")

        @lru_cache(maxsize=1)
        def weights(snr_db: float, trial: int, seed: int) -> Weights:
            return division_weights(
                symbol_moduli(scenario.system, signal, trial, seed), signal.division, snr_db
            )

        @lru_cache(maxsize=1)
        def echo(snr_db: float, trial: int, seed: int) -> Complex:
            return weighted_echo(scenario, self.gate, weights(snr_db, trial, seed).echo)

        @lru_cache(maxsize=1)
        def noise(snr_db: float, trial: int, seed: int) -> Complex:
            weight = self.weights(snr_db, trial, seed).noise
            stream = random_stream(scenario.name, trial, seed, "colour")
            return coloured_noise(self.unit_noise(trial, seed), weight, stream)

        self._weights, self._echo, self._noise = weights, echo, noise

    @one_blas_thread()
    def observe(self, snr_db: float, trial: int = 0, seed: int = 0) -> Observation:
        """Observe the scenario once.

        Parameters
        ----------
        snr_db : float
            Signal-to-noise ratio at the receiver, per resource element and
            virtual element, whatever is sensed with; infinity for no noise.
        trial, seed : int
            Trial and seed of data and noise. Neither depends on the SNR.

        Raises
        ------
        InputError
            If the SNR is no number, or so low that the noise overflows, or the
            grid has no resource element of those that are sensed with.
        """
        if self.signal.is_plain:
            return super().observe(snr_db, trial, seed)
        amplitude = self.noise_amplitude(snr_db)
        noise = amplitude * self.noise_cells(snr_db, trial, seed) if amplitude else 0
        observation = self.observation(self.echo_cells(snr_db, trial, seed) + noise)
        return replace(observation, sensing=self.signal.sensing)

    def weights(self, snr_db: float, trial: int = 0, seed: int = 0) -> Weights:
        """Compute the weights of echo and noise on the resource grid."""
        return self._weights(*self._draw(snr_db, trial, seed))

    def echo_cells(self, snr_db: float, trial: int = 0, seed: int = 0) -> Complex:
        """Compute noise-free cells, not to be written to.

        Returns
        -------
        ndarray of complex128, shape (n_range, n_doppler, P, Q)
        """
        if self.signal.sensing == "all" and self.signal.division == "reciprocal":
            return self.clean
        return self._echo(*self._draw(snr_db, trial, seed))

    def noise_cells(self, snr_db: float, trial: int = 0, seed: int = 0) -> Complex:
        """Compute noise of unit power at the receiver, not to be written to.

        It is the white noise of `unit_noise` with the colour of the weights.

        Returns
        -------
        ndarray of complex128, shape (n_range, n_doppler, P, Q)
        """
        known_snr_db, *_ = self._draw(snr_db, trial, seed)
        return self._noise(known_snr_db, trial, seed)

    def _draw(self, snr_db: float, trial: int, seed: int) -> tuple[float, int, int]:
        """SNR, trial and seed that the weights follow from, with constants for what does not matter."""
        if self.signal.has_unit_modulus:
            return np.inf, 0, 0
        return (snr_db if self.signal.division == "wiener" else np.inf), trial, seed


kept_simulator = lru_cache(maxsize=2)(SignalSimulator)
"""The simulator of a scenario and a signal; the last two are kept."""
