"""The scene: scatterers, and the scenario that adds the radio and the region to them."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from isacbench.checked_arrays import Floats, Mask, freeze_arrays
from isacbench.display import Description, Displayed
from isacbench.errors import InputError, InputWarning, require
from isacbench.files.escaping import plural, quoted
from isacbench.model.array import VirtualArray
from isacbench.model.cloud import PointCloud, describe_points
from isacbench.model.frame import Frame
from isacbench.model.kernels import PERIOD
from isacbench.model.link_budget import LinkBudget
from isacbench.model.number_limits import LARGEST_AMPLITUDE, SMALLEST_AMPLITUDE, require_all, require_places
from isacbench.model.numerology import SPEED_OF_LIGHT_MPS, Prs, System
from isacbench.model.observation import spanned_limits
from isacbench.model.region import Region

MOST_EXPONENT = 1000
"""Of a unit of amplitude, so that neither it nor its reciprocal overflows."""

PLAIN_RADIO = {"noise": ("system", "receiver"), "mimo": ("array", "ideal"), "leakage_db": ("array", None)}
"""Options of the radio that not every task models: their tables and defaults."""

ERRORS = "gain_error_db", "phase_error_deg"
MOST_ERRORS = 10.0, 180.0
"""Largest standard deviations of the errors of gain and phase: beyond them nothing is left of a beam."""

CLUTTER = "clutter "
"""Beginning of the name of an object that is no target of sensing."""

MOST_OF_A_NAME = 60
"""Characters of a scenario's name that its ``repr`` shows."""
ROUNDING = 1e-9
"""Share of the region's largest coordinate, or speed, up to which a scatterer beyond its limits is in it."""

AT_BASE_STATION_M = 1e-9
"""Distance up to which a scatterer is at the base station, where it has no direction."""


@contextmanager
def no_input_warnings() -> Iterator[None]:
    """Make scenarios anew, in another process or under another name, without repeating their warnings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        yield


@dataclass(frozen=True, eq=False, repr=False)
class Scatterers(Displayed):
    """Point scatterers of a scene.

    Attributes
    ----------
    xyz : ndarray of float64, shape (n, 3)
        Positions in metres.
    velocity : ndarray of float64, shape (n,)
        Radial velocities in m/s, positive when approaching.
    amplitude : ndarray of float64, shape (n,)
        Echo amplitudes |G|, 1 for a unit scatterer.
    phase_rad : ndarray of float64, shape (n,)
        Phases of the echoes, to which a coherent system adds the carrier's;
        0 unless given.
    objects : tuple of str, length n or 0
        Object of each scatterer, such as ``vehicle 2``; empty where objects are not known. No echo depends
        on it, and no digest.

    Raises
    ------
    InputError
        If the shapes disagree; if a number is not finite, a position beyond a
        million kilometres or a velocity beyond that of light; or if the power
        of all echoes, unless it is 0, is beyond 1e304 or its reciprocal.
    """

    xyz: Floats
    velocity: Floats
    amplitude: Floats
    phase_rad: Floats = field(default_factory=lambda: np.zeros(()))
    objects: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        freeze_arrays(self, "xyz", "velocity", "amplitude")
        object.__setattr__(self, "phase_rad", np.broadcast_to(self.phase_rad, self.velocity.shape))
        freeze_arrays(self, "phase_rad")
        self._require_shapes()
        require_places("scatterers.xyz", self.xyz)
        limit_mps = SPEED_OF_LIGHT_MPS
        is_slow = np.abs(self.velocity) <= limit_mps
        require_all("scatterers.velocity", self.velocity, is_slow, f"speeds in m/s, at most {limit_mps:g}")
        for name in ("amplitude", "phase_rad"):
            values = getattr(self, name)
            require_all(f"scatterers.{name}", values, np.isfinite(values), "finite numbers")
        total = self.total_amplitude
        fits = total == 0 or SMALLEST_AMPLITUDE <= total <= LARGEST_AMPLITUDE
        limits = f"totals of 0 and from {SMALLEST_AMPLITUDE:g} to {LARGEST_AMPLITUDE:g}"
        require_all("scatterers.amplitude, summed in power,", total, fits, limits)

    def _require_shapes(self) -> None:
        n = self.velocity.size
        if self.xyz.shape != (n, 3) or self.velocity.shape != (n,) or self.amplitude.shape != (n,):
            raise InputError(
                f"scatterers: xyz {self.xyz.shape}, velocity {self.velocity.shape} and amplitude "
                f"{self.amplitude.shape}; allowed are the shapes (n, 3), (n,) and (n,)"
            )
        if len(self.objects) not in (0, n):
            raise InputError(f"scatterers.objects: {len(self.objects)} names; allowed are none or {n}")

    def __len__(self) -> int:
        return self.velocity.size

    def _description(self) -> Description:
        return describe_points("Scatterers", self.xyz, self.velocity, amplitude=self.amplitude)

    @property
    def is_clutter(self) -> Mask:
        """Mask (n,) of the scatterers of clutter."""
        names = self.objects or ("",) * len(self)
        return np.array([name.startswith(CLUTTER) for name in names], dtype=bool)

    @property
    def total_amplitude(self) -> float:
        """Root of the power of all echoes, each on its own."""
        unit, power = self.power_in_units
        return unit * float(np.sqrt(power))

    @cached_property
    def power_in_units(self) -> tuple[float, float]:
        """A unit of amplitude, a power of two, and the power of all echoes in its square, which is near 1."""
        _, exponent = np.frexp(np.abs(self.amplitude).max(initial=0))
        unit = 2.0 ** int(np.clip(exponent, -MOST_EXPONENT, MOST_EXPONENT))
        return unit, float(np.sum((self.amplitude / unit) ** 2))


@dataclass(frozen=True, eq=False, repr=False)
class Scenario(Displayed):
    """Everything that an echo follows from, bar the noise.

    Attributes
    ----------
    base_station_m : ndarray of float64, shape (3,)
    radius_m : float
        Distance in m within which a point counts as one of a scatterer: of
        precision, recall and GOSPA, and of the marks in pictures.
    gain_error_db, phase_error_deg : float
        Standard deviations of the gain and phase errors of the virtual elements,
        which no estimator knows.
    budget : LinkBudget or None
        Link budget that the amplitudes follow from, which are then roots of the SNR of each echo on a
        resource element and virtual element: SNRs are offsets from it. None where SNRs are of all echoes.
    family : str
        Family of a generated scenario, empty for others.
    family_version : int
        Version of the family, 0 for others.

    Raises
    ------
    InputError
        If the radius is no positive number, the base station is beyond a
        million kilometres, the region cannot be observed unambiguously, or a
        scatterer or the whole region lies where the array is blind.

    Warns
    -----
    InputWarning
        If scatterers that are no clutter lie outside the region by more than
        rounding, 1e-9 of its largest coordinate or speed, if scatterers are farther
        away than the cyclic prefix reaches, or if elements are so far apart that
        directions of the region look alike.

    Notes
    -----
    In closed form echoes are those of endless subcarriers: one from beyond the
    cyclic prefix comes without the interference between symbols that it brings.
    One from beyond the unambiguous range or speed folds back, as theory has it.
    """

    name: str
    system: System
    array: VirtualArray
    frame: Frame
    base_station_m: Floats
    region: Region
    scatterers: Scatterers
    radius_m: float = 1.0
    gain_error_db: float = 0.0
    phase_error_deg: float = 0.0
    budget: LinkBudget | None = None
    family: str = ""
    family_version: int = 0

    def __post_init__(self) -> None:
        require(0 < self.radius_m < np.inf, "radius_m", self.radius_m, "a positive number of m")
        errors = self.gain_error_db, self.phase_error_deg
        for name, error, most in zip(ERRORS, errors, MOST_ERRORS, strict=True):
            require(0 <= error <= most, name, error, f"a number from 0 to {most:g}")
        freeze_arrays(self, "base_station_m")
        require_places("base_station_m", self.base_station_m)
        self._require_unambiguous_region()
        self._require_sight()
        self._warn_of_strays()
        self._warn_of_interference()
        self._warn_of_aliases()

    def require_default(self, task: str, *options: str) -> None:
        """Refuse options of the radio that a task does not model: "noise", "mimo" or "leakage_db"."""
        for option in options:
            table, default = PLAIN_RADIO[option]
            value = getattr(getattr(self, table), option)
            require(value == default, f"[{table}] {option}", value, f"{default!r} for {task}")

    def _require_unambiguous_region(self) -> None:
        system, region = self.system, self.region
        if min(self.array.shape) < 2:
            n_p, n_q = self.array.shape
            raise InputError(
                f"array: its {n_p} x {n_q} virtual elements cannot measure both directions; "
                "at least 2 along u and w are needed"
            )
        every_n, every_m = self.array.thinning
        turns = f" for {self.array.n_turns} transmitters with mimo = {self.array.mimo!r}"
        for size, every in (("n_subcarriers", every_n), ("n_symbols", every_m)):
            require(getattr(system, size) % every == 0, size, getattr(system, size), f"a multiple{turns}")
        limit_m, limit_mps = system.unambiguous_range_m / every_n, system.unambiguous_speed_mps / every_m
        farthest_m = region.range_limits_m(self.base_station_m)[1]
        if farthest_m > limit_m:
            raise InputError(
                f"region: its farthest corner is {farthest_m:.1f} m from the base station, beyond the "
                f"unambiguous range; allowed are at most {limit_m:.1f} m, which is "
                f"c / (2 subcarrier_spacing_hz){f', divided,{turns}' if every_n > 1 else ''}"
            )
        fastest_mps = max(abs(speed) for speed in region.speed_mps)
        if fastest_mps > limit_mps:
            raise InputError(
                f"region.speed_mps: {fastest_mps:g} m/s is beyond the unambiguous speed; allowed are at most "
                f"{limit_mps:.1f} m/s{turns if every_m > 1 else ''}"
            )

    def _require_sight(self) -> None:
        corners_m = self.region.corners_m - self.base_station_m
        if not self.frame.in_half_space(corners_m).any():
            raise InputError(
                f"region: it lies where the array is blind; allowed are places {self.frame.half_space}"
            )
        offset_m = self.scatterers.xyz - self.base_station_m
        blind = ~self.frame.in_half_space(offset_m) | (np.linalg.norm(offset_m, axis=1) <= AT_BASE_STATION_M)
        if blind.any():
            x, y, z = self.scatterers.xyz[np.argmax(blind)]
            raise InputError(
                f"objects: {blind.sum()} of {blind.size} scatterers, the first at ({x:g}, {y:g}, {z:g}) m, "
                f"lie where the array is blind; allowed are places {self.frame.half_space}"
            )

    def _warn_of_strays(self) -> None:
        scatterers, region, system = self.scatterers, self.region, self.system
        rounding_m = ROUNDING * max(np.abs(region.corners_m).max(), system.range_bin_m)
        rounding_mps = ROUNDING * max(*map(abs, region.speed_mps), system.velocity_bin_mps)
        inside = region.contains(scatterers.xyz, rounding_m)
        inside &= scatterers.velocity >= region.speed_mps[0] - rounding_mps
        inside &= scatterers.velocity <= region.speed_mps[1] + rounding_mps
        # Clutter may lie anywhere: it is not looked for.
        inside |= scatterers.is_clutter
        if not inside.all():
            warnings.warn(
                f"scenario {self.name}: {np.sum(~inside)} of {inside.size} scatterers lie outside the region "
                "or its speeds, where no estimator looks",
                InputWarning,
                stacklevel=4,
            )

    def _warn_of_interference(self) -> None:
        n_late = int(np.sum(self.range_m > self.system.isi_free_range_m))
        if n_late:
            warnings.warn(
                f"scenario {self.name}: {n_late} of {self.range_m.size} scatterers lie beyond "
                f"{self.system.isi_free_range_m:.1f} m, up to which the cyclic prefix keeps symbols apart; "
                "the interference that their echoes bring is no part of the closed form",
                InputWarning,
                stacklevel=4,
            )

    def _warn_of_aliases(self) -> None:
        if not self.frame.ambiguity:
            return
        limits = spanned_limits(self.region, self.base_station_m, self.frame)
        for axis, (low, high), spacing in zip("uw", limits, self.frame.spacing_wavelengths, strict=True):
            if high - low > PERIOD * (1 + ROUNDING):
                warnings.warn(
                    f"scenario {self.name}: directions of the region look alike along {axis}, where elements "
                    f"are {spacing:g} wavelengths apart: its direction cosines span "
                    f"{(high - low) / (2 * spacing):.2f}, and {1 / spacing:.2f} would be unambiguous; points "
                    "are placed in the middle of the region's angles",
                    InputWarning,
                    stacklevel=4,
                )

    def _description(self) -> Description:
        system, (n_p, n_q) = self.system, self.array.shape
        n_scatterers = plural(len(self.scatterers), "scatterer")
        ambiguity, prs = self.frame.ambiguity, system.prs
        of_prs = f"comb {prs.comb}, {prs.n_symbols} symbols, one slot in {prs.period}"
        place = ", ".join(f"{coordinate:g}" for coordinate in self.base_station_m)
        return Description(
            f"Scenario {quoted(self.name, MOST_OF_A_NAME)}: {n_scatterers}, {n_p} x {n_q} virtual elements",
            {
                "frame": type(self.frame).__name__,
                "carrier": f"{system.carrier_hz / 1e9:.4g} GHz",
                "bandwidth": f"{system.bandwidth_hz / 1e6:.4g} MHz",
                "bins": f"{system.range_bin_m:.3g} m x {system.velocity_bin_mps:.3g} m/s",
                **({"PRS": of_prs} if prs != Prs() else {}),
                **({"ambiguous off broadside from": ambiguity} if ambiguity else {}),
                "base station": f"({place}) m",
                "region": str(self.region),
            },
        )

    @property
    def reference_power(self) -> tuple[float, float]:
        """A unit of amplitude, and the power in its square that an SNR of 0 dB sets against the noise.

        It is that of all echoes; 1 with a link budget, and without echoes.
        """
        unit, power = self.scatterers.power_in_units
        return (1.0, 1.0) if self.budget is not None or power == 0 else (unit, power)

    @property
    def range_m(self) -> Floats:
        """Distances (n,) of the scatterers from the base station."""
        return np.linalg.norm(self.scatterers.xyz - self.base_station_m, axis=1)

    @property
    def truth(self) -> PointCloud:
        """The scatterers as a point cloud, power |G|²."""
        scatterers = self.scatterers
        return PointCloud(scatterers.xyz, scatterers.velocity, scatterers.amplitude**2)
