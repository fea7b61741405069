"""The family ``uma-av``: drops of drones over a sector of an urban macro cell, as 3GPP evaluates sensing.

The geometry is that of TR 38.901, Table 7.9.1-1: drones anywhere in the cell, at least 10 m apart, that fly
horizontally in any direction. docs/3gpp.md has the assumptions one by one.
"""

from __future__ import annotations

import math
from typing import Any

from isacbench.errors import InputError
from isacbench.model.scenes.placement import MOST_TRIES, Sampler
from isacbench.model.scenes.scene_families import UmaAvParameters

BASE_HEIGHT_M = 25.0
SECTOR_DEG = 60.0
APOTHEM_M = 250.0
"""Half the distance of two stations, whose cells are hexagons; the sector faces the middle of a side."""

LEAST_GROUND_M = 10.0
HEIGHTS_M = 25.0, 300.0
APART_M = 10.0
FASTEST_MPS = 50.0

SYSTEM = {
    "carrier_hz": 4.9e9,
    "subcarrier_spacing_hz": 30e3,
    "n_subcarriers": 3276,
    "n_symbols": 560,
    "cyclic_prefix_ratio": 1 / 14,
    "cyclic_suffix_ratio": 0.0,
}
"""273 resource blocks and 40 slots, 20 ms: so short that even the fastest stay in their range cell."""

ON_GROUND = (("tr38901:vehicle", 10, 0.8, 16.7), ("tr38901:human", 20, 1.0, 1.5))
"""Movers on the ground: cross section, number, height in m and largest speed in m/s."""


def draw_uma_av(parameters: UmaAvParameters, key: str) -> dict[str, Any]:
    """Draw drones, and with ``clutter = "ground"`` cars and people on the ground."""
    draws = Sampler(key)
    drones: list[list[float]] = []
    for _ in range(parameters.targets):
        drones.append(_apart(draws, drones))
    objects = [
        {"rcs_dbsm": "tr38901:uav_small", "position_m": place, "velocity_mps": _velocity(draws, FASTEST_MPS)}
        for place in drones
    ]
    if parameters.clutter == "ground":
        for rcs, number, height_m, fastest_mps in ON_GROUND:
            for _ in range(number):
                place, velocity = [*_on_ground(draws), height_m], _velocity(draws, fastest_mps)
                mover = {"rcs_dbsm": rcs, "role": "clutter", "position_m": place, "velocity_mps": velocity}
                objects.append(mover)
    across_m = round(APOTHEM_M * math.sin(math.radians(SECTOR_DEG)))
    return {
        "path_loss": parameters.path_loss,
        "rcs_seed": parameters.seed,
        "system": SYSTEM,
        "prs": {"period": 1},
        "array": {
            **{"frame": "panel", "spacing_wavelengths": [0.5, 0.8]},
            **{"tx_shape": [1, 1], "tx_spacing": 1, "rx_shape": [8, 8], "rx_spacing": 1},
        },
        "base_station": {"position_m": [0.0, 0.0, BASE_HEIGHT_M]},
        "region": {
            "x_m": [-across_m, across_m],
            "y_m": [-APOTHEM_M, -LEAST_GROUND_M * math.cos(math.radians(SECTOR_DEG))],
            "z_m": [*HEIGHTS_M],
            "speed_mps": [-FASTEST_MPS, FASTEST_MPS],
        },
        "budget": {
            **{"tx_power_dbm": parameters.tx_power_dbm, "noise_figure_db": 5.0},
            **{"residual_dbm": -94.0, "element": "tr38901"},
        },
        "objects": [{"kind": "point", **each} for each in objects],
    }


def _apart(draws: Sampler, others: list[list[float]]) -> list[float]:
    """Draw a place in the air that is far enough from others."""
    for _ in range(MOST_TRIES):
        place = [*_on_ground(draws), draws.between(*HEIGHTS_M)]
        if all(math.dist(place, other) >= APART_M for other in others):
            return place
    raise InputError(f"no room for more than {len(others)} drones; allowed are fewer (targets)")


def _on_ground(draws: Sampler) -> list[float]:
    """Draw a place of the sector, uniform in area."""
    while True:
        x, y = draws.between(-APOTHEM_M, APOTHEM_M), draws.between(-APOTHEM_M, 0.0)
        from_station_m, azimuth_deg = math.hypot(x, y), math.degrees(math.atan2(x, -y))
        # A hexagon: no farther than a side from any of the three directions towards sides.
        sides_m = [from_station_m * math.cos(math.radians(azimuth_deg - turn)) for turn in (-60.0, 0.0, 60.0)]
        if abs(azimuth_deg) <= SECTOR_DEG and from_station_m >= LEAST_GROUND_M and max(sides_m) <= APOTHEM_M:
            return [x, y]


def _velocity(draws: Sampler, fastest_mps: float) -> list[float]:
    """Draw a horizontal velocity: any heading, and a uniform speed."""
    speed_mps, heading_rad = draws.between(0.0, fastest_mps), math.radians(draws.between(-180.0, 180.0, 1))
    return [
        round(speed_mps * math.cos(heading_rad), 6) + 0.0,
        round(speed_mps * math.sin(heading_rad), 6) + 0.0,
        0.0,
    ]
