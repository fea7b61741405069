"""Observations through a link: sensing with a part of the grid, and with symbols of unequal power."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from isacbench.checked_arrays import Complex
from isacbench.cores import one_blas_thread
from isacbench.link.sensing.division import Signal, Weights, division_weights, symbol_moduli
from isacbench.link.sensing.noise_colouring import coloured_noise
from isacbench.link.sensing.weighted_echo import weighted_echo
from isacbench.model.echo import Simulator, random_stream
from isacbench.model.observation import Observation
from isacbench.model.scene import Scenario

PLAIN = Signal()


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


@lru_cache(maxsize=2)
def kept_simulator(scenario: Scenario, signal: Signal) -> SignalSimulator:
    """Build the simulator of a scenario and a signal; the last two are kept."""
    return SignalSimulator(scenario, signal)
