"""Clouds as the radio sees them: range, velocity and two direction cosines, and their Rayleigh cells."""

from __future__ import annotations

from typing import get_args

import numpy as np
from numpy.typing import ArrayLike

from isacbench.checked_arrays import Floats
from isacbench.choices import Dimension
from isacbench.errors import InputError
from isacbench.model.cloud import PointCloud
from isacbench.model.echo import random_stream
from isacbench.model.observation import Observation
from isacbench.model.scene import Scatterers, Scenario

DIMENSIONS: tuple[Dimension, ...] = get_args(Dimension)

CANDIDATES = 64
MAX_ROUNDS = 200

Radio = Scenario | Observation
"""Scenario or observation: a radio with its place and its region."""


def rayleigh_cells(radio: Radio) -> Floats:
    """Size of a Rayleigh cell: range bin in m, velocity bin in m/s, 2/P and 2/Q."""
    system, (n_p, n_q) = radio.system, radio.array.shape
    return np.array([system.range_bin_m, system.velocity_bin_mps, 2 / n_p, 2 / n_q])


def gain_db(scenario: Scenario) -> float:
    """Gain in dB from the SNR of the scene at one element to that of one unit scatterer after all sums.

    The sums run over N_c subcarriers, N_sym symbols and P Q elements, or over
    the share of them that each transmitter has where they take turns. The
    SNR of a scene counts the power of all its scatterers, with a link budget
    that of a unit one. Noise that comes back with an echo is that of the echo
    alone, and from its direction: only the sums over subcarriers and symbols gain.
    """
    system, (n_p, n_q) = scenario.system, scenario.array.shape
    gain = system.processing_gain / scenario.array.n_turns
    if system.noise == "transmitter":
        return float(10 * np.log10(gain))
    echo_power = 1.0 if scenario.budget else float(np.sum(scenario.scatterers.amplitude**2)) or 1.0
    return float(10 * np.log10(gain * n_p * n_q / echo_power))


def median_gain_db(scenario: Scenario) -> float:
    """Gain in dB from the SNR of the scene at one element to that of its median scatterer after all sums.

    Returns
    -------
    float
        -inf where half of the amplitudes are 0.
    """
    amplitude = scenario.scatterers.amplitude
    if scenario.system.noise == "transmitter" or not amplitude.size:
        return gain_db(scenario)
    with np.errstate(divide="ignore"):
        return gain_db(scenario) + float(20 * np.log10(np.median(np.abs(amplitude))))


def radio_places(radio: Radio, points: PointCloud | Scatterers) -> Floats:
    """Places (n, 4) of points as the radio sees them: range in m, velocity in m/s, direction cosines u and w.

    The cosines are 0 at the base station itself.
    """
    offset_m = points.xyz - radio.base_station_m
    range_m = np.linalg.norm(offset_m, axis=1)
    is_away = range_m > 0
    u, w = np.zeros((2, range_m.size))
    u[is_away], w[is_away] = radio.frame.direction_cosines(offset_m[is_away])
    return np.stack([range_m, points.velocity, u, w], axis=1)


def space_places(scenario: Scenario, places: ArrayLike) -> tuple[Floats, Floats]:
    """Positions (n, 3) in m and velocities in m/s of places (n, 4) as the radio sees them.

    Positions are NaN for directions outside of the visible region.
    """
    range_m, velocity, u, w = np.asarray(places, dtype=np.float64).T
    return scenario.base_station_m + scenario.frame.offsets(range_m, u, w), velocity


def draw_place(scenario: Scenario, trial: int, seed: int, margin_cells: float) -> Floats:
    """Draw a place off any grid, uniform in space and in speed: range in m, velocity in m/s, u and w.

    Trial, seed and the scenario's name determine it. It is `margin_cells` Rayleigh cells away from the
    border, along each of range, velocity, u and w; an `InputError` if the region has no room for it.
    """
    region, margin = scenario.region, margin_cells * rayleigh_cells(scenario)
    rng = random_stream(scenario.name, trial, seed, "place")
    slowest_mps, fastest_mps = region.speed_mps[0] + margin[1], region.speed_mps[1] - margin[1]
    # Range, u and w a margin up and down.
    probes = np.diag(margin)[[0, 2, 3]]
    probes = np.concatenate([probes, -probes])
    for _ in range(MAX_ROUNDS if slowest_mps <= fastest_mps else 0):
        offset_m = rng.uniform(region.lower_m, region.upper_m, (CANDIDATES, 3)) - scenario.base_station_m
        speed_mps = rng.uniform(slowest_mps, fastest_mps, CANDIDATES)
        u, w = scenario.frame.direction_cosines(offset_m)
        places = np.stack([np.linalg.norm(offset_m, axis=1), speed_mps, u, w], axis=1)
        around, _ = space_places(scenario, (places[:, None, :] + probes).reshape(-1, 4))
        inside = region.contains(around).reshape(CANDIDATES, -1).all(axis=1)
        inside &= scenario.frame.in_half_space(offset_m)
        if inside.any():
            return places[inside.argmax()]
    cell = rayleigh_cells(scenario)
    raise InputError(
        f"scenario {scenario.name}: its region is too small: a scatterer must be at least {margin_cells:g} "
        f"Rayleigh cells from every border; a cell is {cell[0]:.3g} m, {cell[1]:.3g} m/s, {cell[2]:.3g} in "
        f"u and {cell[3]:.3g} in w"
    )
