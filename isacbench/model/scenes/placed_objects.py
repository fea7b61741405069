"""Objects in their places: their scatterers, the surfaces that hide others, and the echoes' strengths."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress, count
from pathlib import Path

import numpy as np
from scipy.special import ndtri

from isacbench.checked_arrays import Floats, Mask
from isacbench.errors import InputError
from isacbench.model.frame import Frame
from isacbench.model.link_budget import LinkBudget, PathLoss, free_space_loss_db, uma_av_loss_db
from isacbench.model.numerology import SPEED_OF_LIGHT_MPS
from isacbench.model.region import Region
from isacbench.model.scene import AT_BASE_STATION_M, Scatterers
from isacbench.model.scenes.raw_uniforms import raw_uniforms
from isacbench.model.scenes.solids import Part
from isacbench.model.surfaces.surface_points import NO_PART, seen_points

CROSS_SECTIONS = {
    "tr38901:uav_small": (-12.81, 3.74),
    "tr38901:uav_large": (-5.85, 2.50),
    "tr38901:human": (-1.37, 3.94),
    "tr38901:vehicle": (11.25, 3.41),
    "tr38901:agv": (-4.25, 2.51),
}
"""10 lg of the mean cross section σ_M in dBsm, and standard deviation of σ_S in dB.

3GPP TR 38.901 V19.4.0, Tables 7.9.2.1-1 to 7.9.2.1-7.
"""

DECIMALS = 6
"""Of a drawn cross section in dBsm: quantiles differ in the last digits between machines."""


def cross_section_dbsm(rcs_dbsm: float | str, key: str) -> float:
    """Radar cross section of an object: the given one, or one of `CROSS_SECTIONS`, drawn by a key.

    A drawn one is σ_M σ_S (3GPP TR 38.901, §7.9.2.1). σ_S is log-normal, and eq. 7.9.2-1 gives
    10 lg σ_S the mean that makes the mean of σ_S 1. The part that depends on
    direction, σ_D, is left out: the visible points of an object already do.
    """
    if not isinstance(rcs_dbsm, str):
        return rcs_dbsm
    mean_dbsm, deviation_db = CROSS_SECTIONS[rcs_dbsm]
    normal = float(ndtri(raw_uniforms(key, 1)[0] + 2.0**-54))
    drawn_db = -math.log(10) / 20 * deviation_db**2 + deviation_db * normal
    return round(mean_dbsm + drawn_db, DECIMALS)


def free_space_amplitudes(range_m: Floats, wavelength_m: float) -> Floats:
    """Amplitudes (n,) of echoes from 1 m² by the radar equation, with isotropic antennas.

    The root of received over transmitted power is λ / ((4π)^1.5 R²): M. A. Richards, Fundamentals of Radar
    Signal Processing, 2nd ed., eq. 2.8.
    """
    return wavelength_m / ((4 * np.pi) ** 1.5 * range_m**2)


@dataclass(frozen=True)
class Surroundings:
    """Surroundings of an object: the scenario's file, base station, region, and if solids are needed."""

    source: Path
    base_station_m: Floats
    region: Region
    with_solids: bool


@dataclass(frozen=True)
class PlacedObject:
    """Object in its place: its scatterers, its parts, and its cross section or the name of a draw."""

    scatterers: Scatterers
    parts: Sequence[Part] = ()
    rcs_dbsm: float | str | None = None
    name: str = ""


def join_scatterers(placed: Sequence[PlacedObject]) -> Scatterers:
    """Join the scatterers of all objects. An object whose name is taken gets the next free number."""
    parts = [each.scatterers for each in placed]
    return Scatterers(
        np.concatenate([np.empty((0, 3)), *(part.xyz for part in parts)]),
        np.concatenate([np.empty(0), *(part.velocity for part in parts)]),
        np.concatenate([np.empty(0), *(part.amplitude for part in parts)]),
        objects=_own_names(
            [each.scatterers.objects or (each.name,) * len(each.scatterers) for each in placed]
        ),
    )


def _own_names(names: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    """Name the objects of all scatterers; a name that an earlier entry of the file has gets a free number."""
    used: set[str] = set()
    found: list[str] = []
    for own in names:
        named = {name: name for name in own}
        again = [name for name in named if name and name in used]
        used |= named.keys()
        for name in again:
            stem = name.rstrip("0123456789 ")
            named[name] = next(one for number in count(2) if (one := f"{stem} {number}") not in used)
            used.add(named[name])
        found += [named[name] for name in own]
    return tuple(found)


def seen_objects(placed: Sequence[PlacedObject], base_station_m: Floats) -> list[PlacedObject]:
    """Keep only the scatterers that the base station sees past the surfaces of all objects; one at least."""
    xyz = join_scatterers(placed).xyz
    numbers = np.cumsum([0, *(len(each.scatterers) for each in placed)])
    point_part = np.full(len(xyz), NO_PART)
    parts = [
        (triangles, first + np.array(own, dtype=int))
        for first, each in zip(numbers[:-1], placed, strict=True)
        for triangles, own in each.parts
    ]
    for part, (_, own) in enumerate(parts):
        point_part[own] = part
    triangles = np.concatenate([np.empty((0, 3, 3)), *(part for part, _ in parts)])
    face_part = np.repeat(np.arange(len(parts)), [len(part) for part, _ in parts])
    is_seen = seen_points(base_station_m, xyz, point_part, triangles, face_part)
    if len(xyz) and not is_seen.any():
        raise InputError(
            f"visible = 'seen': surfaces hide all {len(xyz)} scatterers from the base station; allowed is a "
            "position_m of the base station outside all objects, from which it sees at least one"
        )
    seen = np.split(is_seen, numbers[1:-1]) if placed else []
    return [
        replace(each, scatterers=_selected(each.scatterers, which))
        for each, which in zip(placed, seen, strict=True)
    ]


def _selected(scatterers: Scatterers, which: Mask) -> Scatterers:
    xyz, velocity, amplitude = scatterers.xyz, scatterers.velocity, scatterers.amplitude
    objects = tuple(compress(scatterers.objects, which))
    return Scatterers(xyz[which], velocity[which], amplitude[which], objects=objects)


def with_cross_section(placed: PlacedObject, key: str) -> PlacedObject:
    """Share an object's cross section, if it has one, evenly among its scatterers: amplitudes are √(σ/n)."""
    n = len(placed.scatterers)
    if placed.rcs_dbsm is None or not n:
        return placed
    sigma_m2 = 10 ** (cross_section_dbsm(placed.rcs_dbsm, key) / 10)
    return _with_amplitude(placed, np.full(n, np.sqrt(sigma_m2 / n)))


def with_path_loss(
    placed: PlacedObject, base_station_m: Floats, carrier_hz: float, path_loss: PathLoss, key: str
) -> PlacedObject:
    """Weaken echoes by their distance; what is drawn of an object's path follows from a key."""
    xyz, wavelength_m = placed.scatterers.xyz, SPEED_OF_LIGHT_MPS / carrier_hz
    # A scatterer at the base station is refused later.
    range_m = np.maximum(np.linalg.norm(xyz - base_station_m, axis=1), AT_BASE_STATION_M)
    loss = free_space_amplitudes(range_m, wavelength_m)
    if path_loss == "uma_av" and len(xyz):
        loss_db = uma_av_loss_db(xyz, range_m, base_station_m, carrier_hz, key)
        loss *= 10 ** ((free_space_loss_db(range_m, carrier_hz) - loss_db) / 10)
    return _with_amplitude(placed, placed.scatterers.amplitude * loss)


def with_budget(
    placed: PlacedObject, budget: LinkBudget, unit: float, frame: Frame, base_station_m: Floats
) -> PlacedObject:
    """Turn amplitudes of received over transmitted power into roots of SNRs, antenna gains included."""
    gain = budget.two_way_gain(frame, placed.scatterers.xyz - base_station_m)
    return _with_amplitude(placed, placed.scatterers.amplitude * unit * np.sqrt(gain))


def _with_amplitude(placed: PlacedObject, amplitude: Floats) -> PlacedObject:
    return replace(placed, scatterers=replace(placed.scatterers, amplitude=amplitude))
