"""Frames: maps of a direction in space to the two direction cosines of the array."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from isacbench.checked_arrays import Floats, Mask, checked_array
from isacbench.errors import InputError, require

FrameName = Literal["paper", "panel"]


Spacing = tuple[float, float]

HALF_WAVELENGTHS: Spacing = (0.5, 0.5)
LEAST_SPACING, MOST_SPACING = 0.1, 2.0
"""Spacings in wavelengths: closer elements are no separate ones, and wider ones see hardly one direction."""


class Frame(ABC):
    """A one-to-one map between offsets from the base station and (R, u, w).

    Offsets are scatterer position minus base station position in metres, x
    and y horizontal, z up. u and w are direction cosines where elements are half
    a wavelength apart. At other spacings they are direction cosines times the
    spacing over half a wavelength: the phase from one element to the next is
    -π u, and -π w, at any spacing.
    """

    spacing_wavelengths: Spacing = HALF_WAVELENGTHS

    @abstractmethod
    def direction_cosines(self, offset_m: ArrayLike) -> tuple[Floats, Floats]:
        """Compute the direction cosines of offsets.

        Parameters
        ----------
        offset_m : array_like, shape (n, 3)

        Returns
        -------
        u, w : ndarray of float64, shape (n,)
        """

    @abstractmethod
    def offsets(self, range_m: ArrayLike, u: ArrayLike, w: ArrayLike) -> Floats:
        """Compute the offsets at ranges and direction cosines.

        Parameters
        ----------
        range_m, u, w : array_like, shape (n,)

        Returns
        -------
        ndarray of float64, shape (n, 3)
            In metres; NaN outside the visible region.
        """

    @abstractmethod
    def offset_jacobian(self, range_m: ArrayLike, u: ArrayLike, w: ArrayLike) -> Floats:
        """Compute the derivatives of `offsets` with respect to (R, u, w).

        Parameters
        ----------
        range_m, u, w : array_like, shape (n,)

        Returns
        -------
        ndarray of float64, shape (n, 3, 3)
            Rows are x, y and z, columns R, u and w. NaN where
            there are none: outside the visible region, on its border, and where
            the frame is singular.
        """

    @abstractmethod
    def in_half_space(self, offset_m: ArrayLike) -> Mask:
        """Tell which offsets lie where the map can be inverted, its border included.

        Parameters
        ----------
        offset_m : array_like, shape (n, 3)

        Returns
        -------
        ndarray of bool, shape (n,)
        """

    half_space: ClassVar[str]
    """The half-space in words, for messages."""

    @property
    def cosine_scale(self) -> Floats:
        """Numbers (2,) that direction cosines are multiplied by to give u and w."""
        return 2 * np.array(self.spacing_wavelengths)

    @property
    def ambiguity(self) -> str:
        """Say from which angle off broadside on directions are ambiguous; empty where they are not."""
        wide = [
            f"{np.degrees(np.arcsin(max(1 / spacing - 1, 0.0))):.1f}° along {axis}"
            for axis, spacing in zip("uw", self.spacing_wavelengths, strict=True)
            if spacing > 1 / 2
        ]
        return ", ".join(wide)

    def visible(self, u: Floats, w: Floats) -> Mask:
        """Tell which u and w, of equal shapes, are of a direction in space."""
        scale_u, scale_w = self.cosine_scale
        return np.square(u / scale_u) + np.square(w / scale_w) <= 1


def _normal_cosine(u: Floats, w: Floats) -> Floats:
    """Remaining direction cosine sqrt(1 - u² - w²), NaN outside the visible region."""
    remainder = 1 - np.square(u) - np.square(w)
    # Rounding alone must not push a direction over the border.
    visible = remainder >= -4 * np.finfo(np.float64).eps
    return np.sqrt(np.where(visible, np.maximum(remainder, 0.0), np.nan))


def _nonzero(values: Floats) -> Floats:
    """Values with NaN for 0, where a slope that divides by them has no value."""
    return np.where(values == 0, np.nan, values)


def _jacobian(range_m: ArrayLike, along_range: Floats, along_u: Floats, along_w: Floats) -> Floats:
    """Jacobians (n, 3, 3) of a unit direction and its two slopes, each (n, 3), scaled by the range."""
    scale = checked_array("range_m", range_m)[..., None]
    return np.stack([along_range, scale * along_u, scale * along_w], axis=-1)


@dataclass(frozen=True)
class PaperFrame(Frame):
    """The paper's steering: u = cosθ cosφ, w = sinθ cosφ, φ measured from straight down.

    Not the response of a flat panel, and poorly conditioned in x for a street
    far from the base station: du/dx = cosφ / (R sinφ).

    References
    ----------
    arXiv 2310.06401, steering vector and point reconstruction.
    """

    half_space = "below the base station (z <= z of the base station)"

    def direction_cosines(self, offset_m: ArrayLike) -> tuple[Floats, Floats]:
        """Compute the direction cosines; straight down, where θ is free, θ = 0 is taken."""
        offset = checked_array("offset_m", offset_m)
        cos_phi = -offset[:, 2] / np.linalg.norm(offset, axis=1)
        theta = np.arctan2(-offset[:, 1], offset[:, 0])
        return cos_phi * np.cos(theta), cos_phi * np.sin(theta)

    def offsets(self, range_m: ArrayLike, u: ArrayLike, w: ArrayLike) -> Floats:
        """Compute the offsets; u = w = 0, the horizon, is singular and taken at θ = 0."""
        u, w = checked_array("u", u), checked_array("w", w)
        sin_phi = _normal_cosine(u, w)
        theta = np.arctan2(w + 0.0, u + 0.0)  # + 0 turns -0, whose angle is π, into 0
        direction: Floats = np.stack(
            [sin_phi * np.cos(theta), -sin_phi * np.sin(theta), -np.hypot(u, w)], axis=-1
        )
        return checked_array("range_m", range_m)[..., None] * direction

    def offset_jacobian(self, range_m: ArrayLike, u: ArrayLike, w: ArrayLike) -> Floats:
        """Compute the derivatives; NaN straight down (u² + w² = 1) and at the horizon (u = w = 0)."""
        u, w = checked_array("u", u), checked_array("w", w)
        h, s = _nonzero(np.hypot(u, w)), _nonzero(_normal_cosine(u, w))
        cos_theta, sin_theta = u / h, w / h
        # With h = cosφ and s = sinφ: s falls by h/s, and θ turns by 1/h across the direction (u, w).
        fall, turn = h / s, s / h
        along_u = [
            -fall * cos_theta**2 + turn * sin_theta**2,
            (fall + turn) * cos_theta * sin_theta,
            -cos_theta,
        ]
        along_w = [
            -(fall + turn) * cos_theta * sin_theta,
            fall * sin_theta**2 - turn * cos_theta**2,
            -sin_theta,
        ]
        return _jacobian(
            range_m,
            np.stack([s * cos_theta, -s * sin_theta, -h], axis=-1),
            np.stack(along_u, axis=-1),
            np.stack(along_w, axis=-1),
        )

    def in_half_space(self, offset_m: ArrayLike) -> Mask:
        """Tell which offsets lie below the base station."""
        return checked_array("offset_m", offset_m)[:, 2] <= 0


@dataclass(frozen=True)
class PanelFrame(Frame):
    """A flat panel: u along its horizontal axis, w along its downward axis.

    Without yaw and tilt it faces -y: u = sinφ cosθ = x/R, w = cosφ = -z/R.

    Attributes
    ----------
    yaw_deg : float
        Turn of the panel about the vertical, counter-clockwise seen from above.
    tilt_deg : float
        Downward tilt of the panel's normal.
    spacing_wavelengths : (float, float)
        Distances of elements along u and along w. Beyond half a wavelength, directions are ambiguous.

    Raises
    ------
    InputError
        If a spacing is not from 0.1 to 2 wavelengths.
    """

    yaw_deg: float = 0.0
    tilt_deg: float = 0.0
    spacing_wavelengths: Spacing = HALF_WAVELENGTHS

    def __post_init__(self) -> None:
        for spacing in self.spacing_wavelengths:
            limits = f"a number from {LEAST_SPACING:g} to {MOST_SPACING:g}"
            is_allowed = LEAST_SPACING <= spacing <= MOST_SPACING
            require(is_allowed, "array.spacing_wavelengths", spacing, limits)

    half_space = "in front of the panel"

    @cached_property
    def axes(self) -> Floats:
        """Unit vectors (3, 3) of u, w and the panel's normal, one a row."""
        yaw, tilt = np.deg2rad([self.yaw_deg, self.tilt_deg])
        along_u = np.array([np.cos(yaw), np.sin(yaw), 0.0])
        ahead = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
        down = np.array([0.0, 0.0, -1.0])
        along_w = np.cos(tilt) * down - np.sin(tilt) * ahead
        axes = np.stack([along_u, along_w, np.cos(tilt) * ahead + np.sin(tilt) * down])
        axes.setflags(write=False)
        return axes

    def direction_cosines(self, offset_m: ArrayLike) -> tuple[Floats, Floats]:
        """Compute the direction cosines of offsets, times the spacing over half a wavelength."""
        offset = checked_array("offset_m", offset_m)
        direction = offset / np.linalg.norm(offset, axis=1, keepdims=True)
        u, w = self.cosine_scale[:, None] * (self.axes[:2] @ direction.T)
        return u, w

    def offsets(self, range_m: ArrayLike, u: ArrayLike, w: ArrayLike) -> Floats:
        """Compute the offsets in the half-space that the panel faces."""
        u, w = self._cosines(u, w)
        local = np.stack([u, w, _normal_cosine(u, w)], axis=-1)
        direction: Floats = local @ self.axes
        return checked_array("range_m", range_m)[..., None] * direction

    def offset_jacobian(self, range_m: ArrayLike, u: ArrayLike, w: ArrayLike) -> Floats:
        """Compute the derivatives; NaN in the plane of the panel."""
        (u, w), (scale_u, scale_w) = self._cosines(u, w), self.cosine_scale
        normal = _nonzero(_normal_cosine(u, w))
        one, zero = np.ones_like(normal), np.zeros_like(normal)
        return _jacobian(
            range_m,
            np.stack([u, w, normal], axis=-1) @ self.axes,
            np.stack([one, zero, -u / normal], axis=-1) @ self.axes / scale_u,
            np.stack([zero, one, -w / normal], axis=-1) @ self.axes / scale_w,
        )

    def _cosines(self, u: ArrayLike, w: ArrayLike) -> tuple[Floats, Floats]:
        """Direction cosines of u and w."""
        scale_u, scale_w = self.cosine_scale
        return checked_array("u", u) / scale_u, checked_array("w", w) / scale_w

    def in_half_space(self, offset_m: ArrayLike) -> Mask:
        """Tell which offsets lie in front of the panel."""
        return checked_array("offset_m", offset_m) @ self.axes[2] >= 0


def get_frame(
    name: FrameName,
    yaw_deg: float = 0.0,
    tilt_deg: float = 0.0,
    spacing_wavelengths: Spacing = HALF_WAVELENGTHS,
) -> Frame:
    """Build a frame by name.

    Parameters
    ----------
    name : {"paper", "panel"}
    yaw_deg, tilt_deg : float
        Of a panel.
    spacing_wavelengths : (float, float)
        Of the elements of a panel along u and w.

    Raises
    ------
    InputError
        If yaw, tilt or another spacing than half a wavelength are given to the frame ``paper``, which has
        none.
    """
    if name == "panel":
        return PanelFrame(yaw_deg, tilt_deg, spacing_wavelengths)
    if spacing_wavelengths != HALF_WAVELENGTHS:
        raise InputError(
            "array: spacing_wavelengths is that of a panel; the frame 'paper' has elements half a wavelength "
            "apart"
        )
    if yaw_deg or tilt_deg:
        raise InputError("array: yaw_deg and tilt_deg turn a panel; the frame 'paper' has neither")
    return PaperFrame()
