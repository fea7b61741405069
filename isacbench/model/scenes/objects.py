"""Parametric objects of a street scene: scatterers around their own foot point, and their rigid motion.

Every outline returns offsets (n, 3) in metres from the object's
``position_m``: the centre of its footprint, on the ground. The front of an
object is along +y. Objects are outlined by scatterers as a radar sees them,
not meshed. Lengths are divided into equal steps of about the spacing: those
from 0.8 m on, bar 1.2 to 1.25 m, into steps of 0.5 m ± 20 %.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from isacbench.checked_arrays import Floats
from isacbench.errors import InputError

MOST_STEPS, MOST_POINTS = 2000, 100_000
"""Largest numbers of steps along a length, and of points of a surface."""

DECIMALS = 6
"""Of coordinates in m and speeds in m/s: sines differ in the last digits between machines."""


def _grid(x: Sequence[float] | Floats, y: Sequence[float] | Floats, z: Sequence[float] | Floats) -> Floats:
    """Every combination of the given coordinates."""
    n_points = len(x) * len(y) * len(z)
    if n_points > MOST_POINTS:
        raise InputError(
            f"its spacing_m makes {n_points} scatterers of one surface; allowed are at most {MOST_POINTS}"
        )
    axes = np.meshgrid(x, y, z, indexing="ij")
    return np.stack([axis.ravel() for axis in axes], axis=1)


def _steps(length_m: float, spacing_m: float) -> Floats:
    """Coordinates centred on 0 that span a length in equal steps of about the spacing."""
    return np.linspace(-length_m / 2, length_m / 2, _n_steps(length_m, spacing_m) + 1)


def _n_steps(length_m: float, spacing_m: float) -> int:
    """Number of equal steps of about the spacing in a length."""
    # The quotient may be too large for an integer.
    n_steps = max(1.0, np.round(length_m / spacing_m))
    if n_steps > MOST_STEPS:
        raise InputError(
            f"spacing_m = {spacing_m:g} divides {length_m:g} m into {n_steps:.6g} steps; "
            f"allowed are at most {MOST_STEPS}"
        )
    return int(n_steps)


def car(size_m: Sequence[float] = (2.0, 6.0, 1.8)) -> Floats:
    """Outline a car of a width along x over the mirrors, a length along y and a height.

    Sides, pillars, bonnet and boot, bumpers, roof line, wheels, mirrors: 114 points at the default size.
    """
    width, length, height = size_m
    side = 0.45 * width * np.array([-1.0, 1.0])
    ends = length * np.array([-1 / 3, 1 / 3])
    wheel = min(length, height) / 6
    rim = [_grid(side, end + wheel * np.array([-1, 0, 1]), [wheel]) for end in ends]
    crown = [_grid(side, [end], [0.0, 2 * wheel]) for end in ends]
    bonnet = np.array([4 / 12, 5 / 12, 6 / 12])  # and boot: fractions of the length
    across = width / 4 * np.array([-1, 0, 1])
    lids = [_grid(across, length * y, [0.55 * height]) for y in (-bonnet[::-1], bonnet)]
    return np.concatenate(
        [
            _grid(side, _steps(length, 0.5), [height / 4, height / 2]),
            _grid(side, _steps(length / 2, 0.5), [height]),
            _grid(side, ends, [0.75 * height]),
            *lids,
            _grid(width / 4 * np.array([-1, 1]), [-length / 2, length / 2], [height / 3]),
            *rim,
            *crown,
            _grid(width / 2 * np.array([-1, 1]), [length / 5], [0.6 * height]),
        ]
    )


LEFT_HALF = np.array(
    [
        [0.05, 0.0, 1.0],
        [0.11, 0.0, 0.81],
        [0.16, -0.14, 0.47],
        [0.08, 0.0, 0.53],
        [0.08, 0.11, 0.28],
        [0.08, 0.19, 0.03],
    ]
)
"""Left head, shoulder, hand, hip, knee and foot of a person 1 m tall, the foot a full step ahead."""


def pedestrian(height_m: float = 1.8, stride_phase_deg: float = 0.0) -> Floats:
    """Outline a walking person: left head, shoulder, hand, hip, knee and foot, then the right ones.

    The phase is 0 where the left foot is a full step ahead, 180 where the right one is, and 90 where the left
    one passes it backwards.
    """
    left = LEFT_HALF * np.array([1.0, np.cos(np.radians(stride_phase_deg)), 1.0])
    right = left * np.array([-1.0, -1.0, 1.0])
    right[0, 2] = 0.92  # the head is one: crown on the left, chin on the right
    return height_m * np.concatenate([left, right])


def limb_swing(stride_phase_deg: float) -> Floats:
    """Velocities (12, 3) of a pedestrian's points relative to the body, for a walking speed of 1 m/s.

    Limbs swing as pendulums do. The foot that passes the other one backwards
    stands on the ground, which sets the frequency.
    """
    forwards = -np.sin(np.radians(stride_phase_deg)) * LEFT_HALF[:, 1] / LEFT_HALF[-1, 1]
    swing = np.zeros((2 * len(LEFT_HALF), 3))
    swing[:, 1] = np.concatenate([forwards, -forwards])
    return swing


def lamp_post(
    height_m: float = 10.0, foot_m: float = 2.0, spacing_m: float = 1.0, arm_m: float = 1.0
) -> Floats:
    """Outline a mast, from the top of its foot, which returns no echo, and four arm tips around its top."""
    if foot_m >= height_m:
        raise InputError(f"lamp_post: foot_m = {foot_m:g} must lie below height_m = {height_m:g}")
    n_steps = _n_steps(height_m - foot_m, spacing_m)
    mast = _grid([0.0], [0.0], np.linspace(foot_m, height_m, n_steps + 1))
    arms = arm_m * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    return np.concatenate([mast, arms + np.array([0.0, 0.0, height_m])])


def green_belt(size_m: Sequence[float] = (1.0, 20.0, 1.0), spacing_m: float = 0.5) -> Floats:
    """Outline a hedge by its four long edges, from its width along x, its length along y and its height."""
    width, length, height = size_m
    return _grid([-width / 2, width / 2], _steps(length, spacing_m), [0.0, height])


def box(size_m: Sequence[float] | Floats = (1.0, 6.0, 1.0), spacing_m: float = 0.5) -> Floats:
    """Sample the sides and the top of a box, from its width along x, its length along y and its height."""
    width, length, height = size_m
    x, y = _steps(width, spacing_m), _steps(length, spacing_m)
    levels = _steps(height, spacing_m) + height / 2
    sides = [_rim(_grid(x, y, [level])) for level in levels[:-1]]
    return np.concatenate([*sides, _grid(x, y, levels[-1:])])


def wall(size_m: Sequence[float] = (12.0, 6.0), spacing_m: float = 0.5) -> Floats:
    """Sample an upright wall, from its length along y and its height."""
    length, height = size_m
    return _grid([0.0], _steps(length, spacing_m), _steps(height, spacing_m) + height / 2)


def pole(height_m: float = 6.0, spacing_m: float = 0.5) -> Floats:
    """Sample an upright pole from the ground to its top."""
    return _grid([0.0], [0.0], _steps(height_m, spacing_m) + height_m / 2)


RAIL_HEIGHTS_M = 0.4, 0.9


def rail(length_m: float = 8.0, spacing_m: float = 0.5) -> Floats:
    """Sample the two bars of a guard rail along y, 0.4 m and 0.9 m above the ground."""
    return _grid([0.0], _steps(length_m, spacing_m), RAIL_HEIGHTS_M)


WAIST_M = 0.9
SILL_M = 0.4
WHEEL_RADIUS_M = 0.3
RIM = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
"""Points of a rim around its hub, forwards and up, in radii."""


def vehicle(size_m: Sequence[float] = (1.8, 4.5, 1.5), spacing_m: float = 0.5) -> Floats:
    """Sample a vehicle: a body up to the waist, a cabin over its middle half, and four wheels.

    It is higher than the waist, 0.9 m. The 16 points of the rims come last.
    """
    width, length, height = size_m
    if height <= WAIST_M:
        raise InputError(f"vehicle: its height {height:g} m must be above its waist, {WAIST_M:g} m")
    x, y = _steps(width, spacing_m), _steps(length, spacing_m)
    of_cabin = cabin_rows(length, spacing_m)
    levels = _steps(height - WAIST_M, spacing_m) + (height + WAIST_M) / 2
    waist = _grid(x, y, [WAIST_M])
    is_inside = np.isin(waist[:, 1], of_cabin[1:-1]) & ~np.isin(waist[:, 0], x[[0, -1]])
    shells = [_grid(x, y, [SILL_M]), *(_grid(x, of_cabin, [level]) for level in levels[1:-1])]
    hubs = axle_ends(width, [-0.3 * length, 0.3 * length], WHEEL_RADIUS_M)
    surfaces = [waist[~is_inside], _grid(x, of_cabin, levels[-1:])]
    return np.concatenate([*map(_rim, shells), *surfaces, _rims(hubs, WHEEL_RADIUS_M)])


def cabin_rows(length_m: float, spacing_m: float) -> Floats:
    """Places (n,) along a vehicle of the rows of its cabin."""
    y = _steps(length_m, spacing_m)
    return y[np.abs(y) <= length_m / 4]


def axle_ends(width_m: float, axles_m: Sequence[float], radius_m: float) -> Floats:
    """Hubs (2 n, 3) of wheels that stand on the ground, on both sides of every axle."""
    return _grid([-width_m / 2, width_m / 2], axles_m, [radius_m])


def _rims(hubs: Floats, radius_m: float) -> Floats:
    """Four points on the rim of every wheel."""
    rims = hubs[:, None, :] + radius_m * np.pad(RIM, ((0, 0), (1, 0)))
    return rims.reshape(-1, 3)


def _rim(layer: Floats) -> Floats:
    """Outer points of a level grid."""
    return layer[(np.abs(layer[:, :2]) == np.abs(layer[:, :2]).max(axis=0)).any(axis=1)]


def wheel_roll(n_wheels: int) -> Floats:
    """Velocities (4 n_wheels, 3) of the rim points of wheels relative to the body, for a speed of 1 m/s.

    A wheel rolls: its lowest point stands still, its highest has twice the speed.
    """
    forwards_and_up = np.column_stack([RIM[:, 1], -RIM[:, 0]])
    return np.tile(np.pad(forwards_and_up, ((0, 0), (1, 0))), (n_wheels, 1))


CAB_M, GAP_M = 2.0, 0.5
CAB_FLOOR_M, CARGO_FLOOR_M = 0.5, 1.0
CAB_HEIGHT = 0.8
"""Height of the cab over that of the lorry."""
LORRY_WHEEL_M = 0.5
LEAST_LORRY_M = 5.0, 2.0
"""Least length and height."""


def lorry_boxes(size_m: Sequence[float]) -> list[tuple[Floats, Floats]]:
    """Lower and upper corners of the cab and of the cargo box of a lorry, if it is large enough for them."""
    width, length, height = size_m
    if length < LEAST_LORRY_M[0] or height < LEAST_LORRY_M[1]:
        least = " m and ".join(f"{side:g}" for side in LEAST_LORRY_M)
        raise InputError(f"lorry: {length:g} m long and {height:g} m high; allowed are at least {least} m")
    front, back, half = length / 2, -length / 2, width / 2
    return [
        (np.array([-half, front - CAB_M, CAB_FLOOR_M]), np.array([half, front, CAB_HEIGHT * height])),
        (np.array([-half, back, CARGO_FLOOR_M]), np.array([half, front - CAB_M - GAP_M, height])),
    ]


def lorry_hubs(size_m: Sequence[float]) -> Floats:
    """Hubs (6, 3) of the wheels of a lorry."""
    width, length, _ = size_m
    return axle_ends(width, [1.2 - length / 2, 2.5 - length / 2, length / 2 - 1.2], LORRY_WHEEL_M)


def lorry(size_m: Sequence[float] = (2.5, 9.0, 3.6), spacing_m: float = 0.5) -> Floats:
    """Sample a lorry: sides and tops of cab and cargo box, and six wheels, whose 24 points come last."""
    boxes = [
        box(upper - lower, spacing_m) + np.array([0.0, (lower + upper)[1] / 2, lower[2]])
        for lower, upper in lorry_boxes(size_m)
    ]
    return np.concatenate([*boxes, _rims(lorry_hubs(size_m), LORRY_WHEEL_M)])


LEFT_OF_RIDER = np.array([[0.06, 0.2, 1.75], [0.2, 0.15, 1.4], [0.25, 0.45, 1.05], [0.12, -0.25, 0.95]])
"""Left head, shoulder, hand and hip of a cyclist."""
BRACKET_M = 0.3
"""Height of the axle of the cranks."""
CRANK_M = 0.17
CYCLE_WHEEL_M, CYCLE_AXLES_M = 0.34, (-0.52, 0.52)
GEAR = 2.5
"""Turns of a wheel in a turn of the cranks."""


def cyclist(crank_phase_deg: float = 0.0) -> Floats:
    """Outline a cyclist by 20 points: those of a pedestrian, riding, then 4 on each rim.

    The phase is 0 where the left pedal is highest, 90 where it is foremost.
    """
    phase = np.radians(crank_phase_deg)
    sides = []
    for side, turn in ((1.0, phase), (-1.0, phase + np.pi)):
        upper = LEFT_OF_RIDER * [side, 1.0, 1.0]
        foot = np.array([0.1 * side, CRANK_M * np.sin(turn), BRACKET_M + CRANK_M * np.cos(turn)])
        knee = (upper[-1] + foot) / 2 + [0.0, 0.22, 0.1]
        sides.append(np.vstack([upper, knee, foot]))
    sides[1][0, 2] -= 0.15  # the head is one: crown on the left, chin on the right
    return np.concatenate([*sides, _rims(_grid([0.0], CYCLE_AXLES_M, [CYCLE_WHEEL_M]), CYCLE_WHEEL_M)])


def pedalling(crank_phase_deg: float) -> Floats:
    """Velocities (20, 3) of a cyclist's points relative to the frame, for a speed of 1 m/s.

    Wheels roll, pedals turn once in 2.5 turns of a wheel, and knees move half as fast.
    """
    phase = np.radians(crank_phase_deg)
    foot = CRANK_M / (CYCLE_WHEEL_M * GEAR) * np.array([0.0, np.cos(phase), -np.sin(phase)])
    own = np.zeros((20, 3))
    own[[4, 5, 10, 11]] = foot / 2, foot, -foot / 2, -foot
    own[12:] = wheel_roll(len(CYCLE_AXLES_M))
    return own


def turned(vectors: Floats, yaw_deg: float) -> Floats:
    """Turn vectors (n, 3) about the vertical, counterclockwise seen from above."""
    cos, sin = np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))
    x, y, z = vectors.T
    return np.column_stack([cos * x - sin * y, sin * x + cos * y, z])


def heading(yaw_deg: float) -> Floats:
    """Direction (3,) of an object's front: 0 faces +y, 90 faces -x."""
    return turned(np.array([[0.0, 1.0, 0.0]]), yaw_deg)[0]


def body_velocities(
    offsets: Floats, velocity_mps: Sequence[float], yaw_rate_dps: float, own: Floats
) -> Floats:
    """Velocities (n, 3) of the points of a turning body: V + ω x r, plus their own relative to the body.

    The yaw rate is in degrees a second, counterclockwise seen from above.
    """
    x, y, _ = offsets.T
    turning = np.radians(yaw_rate_dps) * np.column_stack([-y, x, np.zeros_like(x)])
    return np.array(velocity_mps) + turning + own


def approach_speeds(xyz: Floats, velocities: Floats, base_station_m: Floats) -> Floats:
    """Project velocities (n, 3) on the line of sight: positive when approaching, 0 at the base station."""
    sight = xyz - base_station_m
    distance = np.linalg.norm(sight, axis=1)
    return -np.einsum("ij,ij->i", velocities, sight) / np.where(distance > 0, distance, 1.0)
