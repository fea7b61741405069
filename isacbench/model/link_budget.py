"""The link budget: path loss of urban macro cells, the pattern of an element, and the SNR of an echo."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from scipy.special import ndtri

from isacbench.checked_arrays import Floats
from isacbench.errors import InputError, require, require_option
from isacbench.model.array import VirtualArray
from isacbench.model.frame import Frame, PanelFrame
from isacbench.model.numerology import SPEED_OF_LIGHT_MPS, System
from isacbench.model.scenes.raw_uniforms import raw_uniforms

ElementPattern = Literal["isotropic", "tr38901"]
PathLoss = Literal["none", "free_space", "uma_av"]

BOLTZMANN_JK = 1.380649e-23
REFERENCE_K = 290.0
MOST_DB = 300.0

ELEMENT_GAIN_DBI, BEAMWIDTH_DEG, MOST_ATTENUATION_DB = 8.0, 65.0, 30.0
"""3GPP TR 38.901, Table 7.3-1: the same beamwidth and attenuation along either angle, and together."""

LOWEST_M, AERIAL_M, ALWAYS_SEEN_M = 1.5, 22.5, 100.0
"""Height below which the formulas do not go, from which those for aerial vehicles hold, and from which all
are in line of sight (3GPP TR 36.777, Table B-1)."""

DECIMALS = 6
"""Of a drawn shadow fading in dB: quantiles differ in the last digits between machines."""


@dataclass(frozen=True)
class LinkBudget:
    """Powers from which the SNR of each echo follows.

    The transmit power is spread evenly over all subcarriers: also of a reference signal, which could be
    boosted where it leaves subcarriers free. With ``mimo = "ideal"`` transmitters share the power.

    Attributes
    ----------
    tx_power_dbm : float
        Power of the transmitter in an OFDM symbol.
    noise_figure_db : float
        Noise figure of the receivers, over kT at 290 K.
    residual_dbm : float or None
        What isolation and cancellation leave of the transmitters' leakage, as white noise in the bandwidth of
        all subcarriers; None for nothing.
    element : {"isotropic", "tr38901"}
        Pattern of transmitting and receiving elements: 0 dBi in all directions, or that of 3GPP TR 38.901,
        Table 7.3-1, which has 8 dBi and needs a panel.

    Raises
    ------
    InputError
        If a power or the noise figure is no number of dB within 300 dB, or the pattern is unknown.
    """

    tx_power_dbm: float
    noise_figure_db: float = 0.0
    residual_dbm: float | None = None
    element: ElementPattern = "isotropic"

    def __post_init__(self) -> None:
        for name in ("tx_power_dbm", "noise_figure_db", "residual_dbm"):
            value = getattr(self, name)
            limits = f"a number from -{MOST_DB:g} to {MOST_DB:g}"
            require(value is None or abs(value) <= MOST_DB, f"budget.{name}", value, limits)
        require_option(self, "element", get_args(ElementPattern))

    def noise_w(self, system: System) -> float:
        """Noise power in W on a resource element of a receiving element."""
        thermal = BOLTZMANN_JK * REFERENCE_K * system.subcarrier_spacing_hz
        residual = 0.0 if self.residual_dbm is None else _watts(self.residual_dbm) / system.n_subcarriers
        return float(thermal * 10 ** (self.noise_figure_db / 10) + residual)

    def unit_amplitude(self, system: System, array: VirtualArray) -> float:
        """Root of the SNR, on a resource element and virtual element, of what all power would give there."""
        n_sharing = array.tx_shape[0] * array.tx_shape[1] if array.mimo == "ideal" else 1
        received_w = _watts(self.tx_power_dbm) / system.n_subcarriers / n_sharing
        return float(np.sqrt(received_w / self.noise_w(system)))

    def two_way_gain(self, frame: Frame, offset_m: Floats) -> Floats:
        """Gain (n,) of power towards offsets (n, 3) and back, of one element each way.

        Raises
        ------
        InputError
            If the pattern needs a panel, which the frame is none of.
        """
        if self.element == "isotropic":
            return np.ones(len(offset_m))
        if not isinstance(frame, PanelFrame):
            raise InputError('budget: element = "tr38901" needs frame = "panel" in [array], not "paper"')
        return 10 ** (2 * element_gain_dbi(frame, offset_m) / 10)


def element_gain_dbi(frame: PanelFrame, offset_m: Floats) -> Floats:
    """Gain (n,) in dBi of an element of a panel towards offsets (n, 3): 3GPP TR 38.901, Table 7.3-1."""
    across, down, ahead = frame.axes @ (offset_m / np.linalg.norm(offset_m, axis=1, keepdims=True)).T
    angles_deg = np.degrees([np.arcsin(np.clip(down, -1, 1)), np.arctan2(across, ahead)])
    attenuation_db = np.minimum(12 * (angles_deg / BEAMWIDTH_DEG) ** 2, MOST_ATTENUATION_DB).sum(axis=0)
    return ELEMENT_GAIN_DBI - np.minimum(attenuation_db, MOST_ATTENUATION_DB)


def free_space_loss_db(range_m: Floats, carrier_hz: float) -> Floats:
    """Loss (n,) in dB of one way in free space, with isotropic antennas."""
    return 20 * np.log10(4 * np.pi * carrier_hz / SPEED_OF_LIGHT_MPS * range_m)


def uma_av_loss_db(
    xyz: Floats, range_m: Floats, base_station_m: Floats, carrier_hz: float, key: str
) -> Floats:
    """Loss of one way between a base station of an urban macro cell and the points of an object.

    Line of sight and shadow fading are drawn once for an object, by its mean position; in monostatic sensing
    they are the same on both ways (3GPP TR 38.901 V19.4.0, §7.9.4.1). Points below 1.5 m count as at 1.5 m.

    Parameters
    ----------
    xyz : ndarray of float64, shape (n, 3)
        Points in m, at least one.
    range_m : ndarray of float64, shape (n,)
        Their distances.
    key : str
        Of the draws.

    Returns
    -------
    ndarray of float64, shape (n,)
        In dB, shadow fading included.

    References
    ----------
    3GPP TR 36.777 V15.0.0, Tables B-1 to B-3 (UMa-AV); below 22.5 m TR 38.901 V19.4.0, Tables 7.4.1-1 and
    7.4.2-1 (UMa).
    """
    (middle_m, middle_height_m), (ground_m, height_m) = (
        _cell_places(points, base_station_m) for points in (xyz.mean(axis=0, keepdims=True), xyz)
    )
    uniform, of_fading = raw_uniforms(key, 2)
    is_seen = bool(uniform < uma_av_sight(middle_m, middle_height_m)[0])
    deviation_db = _fading_deviation_db(float(middle_height_m[0]), is_seen)
    fading_db = round(deviation_db * float(ndtri(of_fading + 2.0**-54)), DECIMALS)
    base_m = float(base_station_m[2])
    return fading_db + _mean_loss_db(range_m, ground_m, height_m, base_m, carrier_hz, is_seen)


def uma_av_sight(ground_m: Floats, height_m: Floats) -> Floats:
    """Probability of line of sight at distances along the ground and heights, each shape (n,) in m."""
    # 3GPP TR 36.777, Table B-1; its parameters are those of heights to which it applies.
    aerial_m = np.clip(height_m, AERIAL_M, ALWAYS_SEEN_M)
    sure_m = np.where(height_m > AERIAL_M, np.maximum(460 * np.log10(aerial_m) - 700, 18), 18.0)
    decay_m = np.where(height_m > AERIAL_M, 4300 * np.log10(aerial_m) - 3800, 63.0)
    share = sure_m / np.maximum(ground_m, sure_m)
    seen = share + np.exp(-ground_m / decay_m) * (1 - share)
    # 3GPP TR 38.901, Table 7.4.2-1: receivers above 13 m see more.
    rise = np.where(height_m > AERIAL_M, 0.0, (np.maximum(height_m - 13, 0) / 10) ** 1.5)
    seen *= 1 + rise * 1.25 * (ground_m / 100) ** 3 * np.exp(-ground_m / 150) * (ground_m > sure_m)
    return np.where(height_m > ALWAYS_SEEN_M, 1.0, np.minimum(seen, 1.0))


def _mean_loss_db(
    range_m: Floats, ground_m: Floats, height_m: Floats, base_m: float, carrier_hz: float, is_seen: bool
) -> Floats:
    """Loss (n,) in dB of one way without shadow fading."""
    carrier_ghz, is_aerial = carrier_hz / 1e9, height_m > AERIAL_M
    along, carrier = np.log10(range_m), 20 * np.log10(carrier_ghz)
    seen_db = 28.0 + 22 * along + carrier
    # The breakpoint of terrestrial receivers, with an effective height of the surroundings of 1 m.
    breakpoint_m = 4 * (base_m - 1) * (height_m - 1) * carrier_hz / SPEED_OF_LIGHT_MPS
    beyond_db = 28.0 + 40 * along + carrier - 9 * np.log10(breakpoint_m**2 + (base_m - height_m) ** 2)
    seen_db = np.where(is_aerial | (ground_m <= breakpoint_m), seen_db, beyond_db)
    if is_seen:
        return seen_db
    aerial_db = -17.5 + (46 - 7 * np.log10(height_m)) * along + 20 * np.log10(40 * np.pi * carrier_ghz / 3)
    ground_db = np.maximum(seen_db, 13.54 + 39.08 * along + carrier - 0.6 * (height_m - 1.5))
    return np.where(is_aerial, aerial_db, ground_db)


def _fading_deviation_db(height_m: float, is_seen: bool) -> float:
    """Standard deviation of the shadow fading in dB."""
    if not is_seen:
        return 6.0
    return float(4.64 * np.exp(-0.0066 * height_m)) if height_m > AERIAL_M else 4.0


def _cell_places(xyz: Floats, base_station_m: Floats) -> tuple[Floats, Floats]:
    """Distances along the ground, and heights, to which the formulas of a cell apply, each (n,) in m."""
    ground_m = np.hypot(*(xyz - base_station_m)[:, :2].T)
    return ground_m, np.maximum(xyz[:, 2], LOWEST_M)


def _watts(power_dbm: float) -> float:
    return float(10 ** (power_dbm / 10 - 3))
