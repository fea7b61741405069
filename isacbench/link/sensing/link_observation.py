"""Observations through a link: sensing with part of the grid, and with symbols of unequal power."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Generic, TypeVar

from isacbench.link.sensing.division import division_weights, symbol_moduli
from isacbench.link.sensing.noise_colouring import coloured_noise
from isacbench.link.sensing.weighted_echo import weighted_echo
from isacbench.link.waveform.sent_signal import Signal
from isacbench.model.echo import Simulator, random_stream

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from isacbench.link.sensing.division import Weights
    from isacbench.model.observation import Observation
    from isacbench.model.scene import Scenario

    Complex = NDArray[np.complex128]

PLAIN = Signal()

T = TypeVar("T")

Key = tuple[int | float, ...]
"""What something computed depends on: trial and seed, and in Wiener division the SNR."""


class _Last(Generic[T]):
    """The last of several values that take long to compute."""

    def __init__(self) -> None:
        self._kept: tuple[Key, T] | None = None

    def of(self, key: Key, compute: Callable[[], T]) -> T:
        """Value under a key, computed unless it is the last one."""
        # Looked at once: another thread may put another value there meanwhile.
        kept = self._kept
        if kept is None or kept[0] != key:
            kept = key, compute()
            self._kept = kept
        return kept[1]


class SignalSimulator(Simulator):
    """Observations of one scenario that is illuminated by a signal.

    What does not change from trial to trial, or from SNR to SNR, is computed
    once. Signals that leave the closed form as it is cost what it costs. `clean`
    and `unit_noise` are those of the whole grid with symbols of unit modulus.

    Parameters
    ----------
    scenario : Scenario
    signal : Signal, optional
        QPSK on the whole grid unless given.
    """

    def __init__(self, scenario: Scenario, signal: Signal = PLAIN) -> None:
        super().__init__(scenario)
        self.signal = signal
        self._moduli: _Last[NDArray[np.float64]] = _Last()
        self._weights: _Last[Weights] = _Last()
        self._echo: _Last[Complex] = _Last()
        self._noise: _Last[Complex] = _Last()

    def observe(self, snr_db: float, trial: int = 0, seed: int = 0) -> Observation:
        """Observe the scenario once.

        Parameters
        ----------
        snr_db : float
            Signal-to-noise ratio at the receiver, per resource element and
            virtual element, whatever is sensed with; infinity for no noise.
        trial, seed : int
            Which data and which noise. Neither depends on the SNR.

        Returns
        -------
        Observation

        Raises
        ------
        InputError
            If the SNR is no number, or so low that the noise overflows, or the
            grid has no resource element of those that are sensed with.
        """
        if self.signal.is_plain:
            return super().observe(snr_db, trial, seed)
        noise_amplitude = self.noise_amplitude(snr_db)
        cells = self.echo_cells(snr_db, trial, seed)
        if noise_amplitude:
            noise = noise_amplitude * self.noise_cells(snr_db, trial, seed)
            noise += cells
            return self._sensed(noise)
        return self._sensed(cells.copy())

    def _sensed(self, cells: Complex) -> Observation:
        """Observation that tells which resource elements were sensed with."""
        return replace(self.observation(cells), sensing=self.signal.sensing)

    def weights(self, snr_db: float, trial: int = 0, seed: int = 0) -> Weights:
        """Weights of echo and noise on the resource grid."""
        signal = self.signal
        data: Key = () if signal.has_unit_modulus else (trial, seed)

        def moduli() -> NDArray[np.float64]:
            return symbol_moduli(self.scenario.system, signal, trial, seed)

        def weights() -> Weights:
            return division_weights(self._moduli.of(data, moduli), signal.division, snr_db)

        return self._weights.of(self._key(snr_db, trial, seed), weights)

    def echo_cells(self, snr_db: float, trial: int = 0, seed: int = 0) -> Complex:
        """Noise-free cells (n_range, n_doppler, P, Q), not to be written to."""
        signal = self.signal
        if signal.sensing == "all" and signal.division == "reciprocal":
            return self.clean

        def echo() -> Complex:
            return weighted_echo(self.scenario, self.gate, self.weights(snr_db, trial, seed).echo)

        return self._echo.of(self._key(snr_db, trial, seed), echo)

    def noise_cells(self, snr_db: float, trial: int = 0, seed: int = 0) -> Complex:
        """Noise (n_range, n_doppler, P, Q) over that of the receiver's amplitude, not to be written to.

        The white noise of `unit_noise` with the colour of the weights.
        """

        def noise() -> Complex:
            weight = self.weights(snr_db, trial, seed).noise
            stream = random_stream(self.scenario.name, trial, seed, "colour")
            return coloured_noise(self.unit_noise(trial, seed), weight, stream)

        # Also of weights that do not change there is new noise in each trial.
        return self._noise.of((*self._key(snr_db, trial, seed), trial, seed), noise)

    def _key(self, snr_db: float, trial: int, seed: int) -> Key:
        """What the weights depend on."""
        if self.signal.has_unit_modulus:
            return ()
        return (trial, seed, float(snr_db)) if self.signal.division == "wiener" else (trial, seed)


@lru_cache(maxsize=2)
def kept_simulator(scenario: Scenario, signal: Signal) -> SignalSimulator:
    """Simulator of a scenario and a signal; the last two are kept, with what they have computed.

    Parameters
    ----------
    scenario : Scenario
    signal : Signal

    Returns
    -------
    SignalSimulator
    """
    return SignalSimulator(scenario, signal)
