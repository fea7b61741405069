"""Channels from the base station to the user: paths of the waveform, and their factors on resource elements.

Delays count from the first path to arrive: the user's clock is that path's.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import ClassVar, Literal, Protocol, get_args

import numpy as np
import pandas as pd
from scipy import constants

from isacbench.checked_arrays import Complex, Floats, freeze_arrays
from isacbench.errors import InputError, require, require_known
from isacbench.model.number_limits import LARGEST_PLACE_M, require_all
from isacbench.model.numerology import SPEED_OF_LIGHT_MPS, System

Polarization = Literal["vertical", "horizontal"]

ProfileName = Literal["tdl_a", "tdl_b", "tdl_c", "tdl_d", "tdl_e"]

WITH_LINE_OF_SIGHT: tuple[ProfileName, ...] = ("tdl_d", "tdl_e")

LARGEST_INTERFERENCE = 1e-4
"""Power that Doppler may spread from each subcarrier over the others, relative to its own."""

RAYS_A_TAP = 16
"""Rays that a fading tap of a moving user consists of."""

LINE_OF_SIGHT_DOPPLER = 0.7
"""Doppler of the line of sight over the largest there is; 3GPP TR 38.901, 7.7.2."""


@dataclass(frozen=True, eq=False)
class Paths:
    """Propagation paths from the transmitter to every receiving element.

    Attributes
    ----------
    gain : ndarray of complex128, shape (K, E)
        Complex amplitude of each path at each element.
    delay_s : ndarray of float64, shape (K,)
        Not negative.
    doppler_hz : ndarray of float64, shape (K,)
        Doppler frequency, positive when the path grows shorter.

    Raises
    ------
    InputError
        If the shapes disagree, a number is not finite, or a delay is negative.
    """

    gain: Complex
    delay_s: Floats
    doppler_hz: Floats

    def __post_init__(self) -> None:
        freeze_arrays(self, "delay_s", "doppler_hz")
        freeze_arrays(self, "gain", dtype=np.complex128)
        n = self.delay_s.size
        if self.gain.ndim != 2 or {self.delay_s.shape, self.doppler_hz.shape, self.gain.shape[:1]} != {(n,)}:
            raise InputError(
                f"paths: gain {self.gain.shape}, delay_s {self.delay_s.shape} and doppler_hz "
                f"{self.doppler_hz.shape}; allowed are the shapes (K, E), (K,) and (K,)"
            )
        for name in ("gain", "doppler_hz"):
            values = getattr(self, name)
            require_all(f"paths.{name}", np.abs(values), np.isfinite(values), "finite numbers")
        is_delay = np.isfinite(self.delay_s) & (self.delay_s >= 0)
        require_all("paths.delay_s", self.delay_s, is_delay, "finite numbers of 0 and more")


class Channel(Protocol):
    """Channel between base station and user."""

    name: ClassVar[str]

    def paths(self, system: System, stream: np.random.Generator) -> Paths:
        """Draw the paths of one frame to one antenna: gain (n_paths, 1), mean power 1 together.

        Parameters
        ----------
        stream : Generator
            Random numbers, for channels that are random.
        """
        ...


@dataclass(frozen=True)
class Awgn:
    """One path that changes nothing: the receiver adds white noise."""

    name: ClassVar[str] = "awgn"

    def paths(self, system: System, stream: np.random.Generator) -> Paths:
        """Make one path without delay."""
        return Paths(np.ones((1, 1), dtype=np.complex128), np.zeros(1), np.zeros(1))


@dataclass(frozen=True)
class TwoRay:
    """Direct ray, and one reflected by a smooth ground; nothing about them is random.

    The gain is such that the mean power over the subcarriers is 1: an SNR with
    this channel is that of what arrives, interference of the rays included.
    Antennas are isotropic; nobody moves.

    Attributes
    ----------
    distance_m : float
        Along the ground.
    permittivity : float
        Of the ground, relative; the default is that of concrete.
    conductivity_spm : float
        Of the ground in S/m; the default is that of concrete at 70 GHz.
    polarization : {"vertical", "horizontal"}

    References
    ----------
    ITU-R P.2040, table 3 (concrete: 5.24, and 0.0462 f^0.7822 with f in GHz).
    """

    name: ClassVar[str] = "two_ray"

    base_station_height_m: float = 10.0
    ue_height_m: float = 1.5
    distance_m: float = 50.0
    permittivity: float = 5.24
    conductivity_spm: float = 1.28
    polarization: Polarization = "vertical"

    def __post_init__(self) -> None:
        for name in ("base_station_height_m", "ue_height_m", "distance_m"):
            value = getattr(self, name)
            allowed = 0 < value <= LARGEST_PLACE_M
            require(allowed, name, value, f"a positive number of m, at most {LARGEST_PLACE_M:g}")
        require(1 <= self.permittivity < np.inf, "permittivity", self.permittivity, "a number from 1")
        allowed = 0 <= self.conductivity_spm < np.inf
        require(allowed, "conductivity_spm", self.conductivity_spm, "a number of S/m from 0")
        require_known("polarization", self.polarization, get_args(Polarization))

    def paths(self, system: System, stream: np.random.Generator) -> Paths:
        """Make the direct and the reflected ray, in this order."""
        direct_m = np.hypot(self.distance_m, self.base_station_height_m - self.ue_height_m)
        heights_m = self.base_station_height_m + self.ue_height_m
        reflected_m = np.hypot(self.distance_m, heights_m)
        # Not reflected_m - direct_m, whose digits cancel far away.
        longer_m = 4 * self.base_station_height_m * self.ue_height_m / (direct_m + reflected_m)
        coefficient = reflection_coefficient(
            heights_m / reflected_m,
            self.permittivity,
            self.conductivity_spm,
            system.carrier_hz,
            self.polarization,
        )
        turns = longer_m / system.wavelength_m
        reflected = coefficient * direct_m / reflected_m * np.exp(-2j * np.pi * turns)
        delay_s = np.array([0.0, longer_m / SPEED_OF_LIGHT_MPS])
        gain = np.array([1.0, reflected])
        response = _along_delay(system, delay_s) @ gain
        gain /= np.sqrt(np.mean(np.abs(response) ** 2))
        return Paths(gain[:, None], delay_s, np.zeros(2))


@dataclass(frozen=True)
class TappedDelay:
    """Taps of a 3GPP profile that fade independently; the mean power over all fades is 1.

    The power of one frame is not 1: fades of the whole band belong to the
    channel. A user at rest sees the same channel during the whole frame.

    Attributes
    ----------
    profile : {"tdl_a", "tdl_b", "tdl_c", "tdl_d", "tdl_e"}
    delay_spread_s : float
        Root mean square. The default is the median of urban micro street
        canyons without line of sight at 70 GHz; with line of sight it is
        26 ns there.
    speed_mps : float
        Of the user. Every tap of a moving one is a sum of rays from
        directions all around it.

    References
    ----------
    3GPP TR 38.901, 7.7.2; delay spreads from table 7.5-6.

    Examples
    --------
    >>> from isacbench.model.numerology import System
    >>> paths = TappedDelay("tdl_b").paths(System(), np.random.default_rng(0))
    >>> paths.gain.shape
    (23, 1)
    """

    name: ClassVar[str] = "tapped_delay"

    profile: ProfileName = "tdl_a"
    delay_spread_s: float = 53e-9
    speed_mps: float = 0.0

    def __post_init__(self) -> None:
        delay_profile(self.profile)
        allowed = 0 <= self.delay_spread_s < np.inf
        require(allowed, "delay_spread_s", self.delay_spread_s, "a number of s from 0")
        allowed = 0 <= self.speed_mps < SPEED_OF_LIGHT_MPS
        require(allowed, "speed_mps", self.speed_mps, "a number of m/s from 0, below that of light")

    def paths(self, system: System, stream: np.random.Generator) -> Paths:
        """Draw one fade: one path for each tap, of a moving user `RAYS_A_TAP` for each fading tap."""
        profile = delay_profile(self.profile)
        n_fixed = int(profile.has_line_of_sight)
        n_rays = RAYS_A_TAP if self.speed_mps else 1
        power = np.repeat(profile.power[n_fixed:] / n_rays, n_rays)
        delay = np.repeat(profile.delay[n_fixed:], n_rays)
        parts = stream.standard_normal((power.size, 2)) @ np.array([1, 1j])
        gain = np.sqrt(power / 2) * parts
        largest_hz = self.speed_mps * system.carrier_hz / SPEED_OF_LIGHT_MPS
        doppler_hz = largest_hz * np.cos(stream.uniform(0, 2 * np.pi, power.size))
        if profile.has_line_of_sight:
            turns = stream.uniform()
            gain = np.append(np.sqrt(profile.power[0]) * np.exp(2j * np.pi * turns), gain)
            delay = np.append(profile.delay[0], delay)
            doppler_hz = np.append(LINE_OF_SIGHT_DOPPLER * largest_hz, doppler_hz)
        return Paths(gain[:, None], self.delay_spread_s * delay, doppler_hz)


def reflection_coefficient(
    sine: float, permittivity: float, conductivity_spm: float, carrier_hz: float, polarization: Polarization
) -> complex:
    """Fresnel's reflection coefficient of a smooth ground, by the sine of the angle of the ray to it.

    The electric field is in the plane of incidence ("vertical"), or along the ground.
    """
    relative = permittivity - 1j * conductivity_spm / (2 * np.pi * carrier_hz * constants.epsilon_0)
    refracted = np.sqrt(relative - (1 - sine**2))
    incident = sine if polarization == "horizontal" else relative * sine
    return complex((incident - refracted) / (incident + refracted))


def channel_response(system: System, paths: Paths) -> Complex:
    """Compute the channel on every resource element to the first antenna, in closed form.

    Returns
    -------
    ndarray of complex128, shape (n_subcarriers, n_symbols) or (n_subcarriers, 1)
        Factor on each resource element; one column where no path has Doppler.

    Raises
    ------
    InputError
        If a path is so late, or its Doppler so high, that resource elements
        interfere with each other: no factor of single elements describes that.
    """
    require_closed_form(system, paths)
    gain, along_delay = paths.gain[:, 0], _along_delay(system, paths.delay_s)
    if not paths.doppler_hz.any():
        return (along_delay @ gain)[:, None]
    share = paths.doppler_hz / system.subcarrier_spacing_hz
    # The FFT over a symbol that turns loses this.
    useful = np.sinc(share) / np.sinc(share / system.n_subcarriers)
    time_s = system.symbol_time_s * np.arange(system.n_symbols)
    along_time = np.exp(2j * np.pi * np.outer(time_s, paths.doppler_hz)) * (useful * gain)
    by_symbol: Complex = along_time @ along_delay.T
    return by_symbol.T


def require_closed_form(system: System, paths: Paths) -> None:
    """Refuse paths that no factor of single resource elements describes, see `channel_response`."""
    latest_s, limit_s = float(paths.delay_s.max()), system.isi_free_delay_s
    if latest_s > limit_s:
        raise InputError(
            f"path at {latest_s:g} s: the closed form allows {limit_s:g} s, the prefix without the suffix"
        )
    share = float(np.abs(paths.doppler_hz).max()) / system.subcarrier_spacing_hz
    interference = (np.pi * share) ** 2 / 3
    if interference > LARGEST_INTERFERENCE:
        raise InputError(
            f"Doppler of {share:.3g} subcarrier spacings: subcarriers interfere with {interference:.1e} of "
            f"their power; the closed form allows {LARGEST_INTERFERENCE:g}"
        )


def _along_delay(system: System, delay_s: Floats) -> Complex:
    """Phases (n_subcarriers, n_paths) of delays."""
    frequency_hz = system.subcarrier_spacing_hz * np.arange(system.n_subcarriers)
    return np.exp(-2j * np.pi * np.outer(frequency_hz, delay_s))


@dataclass(frozen=True, eq=False)
class Profile:
    """Taps of a channel.

    Attributes
    ----------
    delay : ndarray of float64, shape (n_taps,)
        In units of the rms delay spread, the first tap at 0.
    power : ndarray of float64, shape (n_taps,)
        Mean powers, together 1.
    has_line_of_sight : bool
        Whether the first tap is a constant ray; all others are Rayleigh fading.
    """

    delay: Floats
    power: Floats
    has_line_of_sight: bool


def delay_profile(name: ProfileName) -> Profile:
    """Look up the taps of a profile.

    References
    ----------
    3GPP TR 38.901, tables 7.7.2-1 to 7.7.2-5.
    """
    require_known("profile", name, get_args(ProfileName))
    taps = _taps().loc[[name]]
    power = 10 ** (taps["power_db"].to_numpy() / 10)
    return Profile(taps["delay"].to_numpy(), power / power.sum(), name in WITH_LINE_OF_SIGHT)


@cache
def _taps() -> pd.DataFrame:
    """Delay and power of the taps of all profiles, indexed by the profile.

    A line of sight is a tap of its own, at the delay of the Rayleigh tap behind it.
    """
    return pd.read_csv(Path(__file__).with_name("delay_profiles.csv"), index_col="profile")
