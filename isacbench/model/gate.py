"""The gate: the range-Doppler cells that a scenario's region and speeds can reach."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from isacbench.checked_arrays import Floats, Integers, Mask, freeze_arrays
from isacbench.display import Description, Displayed, range_text
from isacbench.model.numerology import System
from isacbench.model.region import Region

RANGE_MARGIN_BINS = 6
"""Half a 9-cell detector window, one bin of window leakage, one for rounding."""

DOPPLER_MARGIN_BINS = 8
"""As in range, plus enough cells beyond all speeds of the region to estimate the noise from."""

Bins = tuple[Integers, Integers]
"""Range bins and Doppler bins of cells."""


@dataclass(frozen=True, eq=False, repr=False)
class Gate(Displayed):
    """Range and Doppler bins kept of the range-Doppler map.

    Attributes
    ----------
    range_bins : ndarray of int64, shape (n_range,)
        Consecutive range bins; negative ones stand for bins at the far end.
    doppler_bins : ndarray of int64, shape (n_doppler,)
        Consecutive signed Doppler bins, positive when approaching.
    reachable_range, reachable_doppler : slice
        Slices of these bins that are nearest to a reachable range or speed; the
        rest is margin.
    wraps : (bool, bool)
        Whether the gate holds all range bins, and all Doppler bins, of the map:
        the last one is then next to the first.
    """

    range_bins: Integers
    doppler_bins: Integers
    reachable_range: slice
    reachable_doppler: slice
    wraps: tuple[bool, bool] = (False, False)

    def __post_init__(self) -> None:
        freeze_arrays(self, "range_bins", "doppler_bins", dtype=np.int64)

    def _description(self) -> Description:
        n_range, n_doppler = self.shape
        reachable = tuple(
            len(range(*part.indices(n)))
            for part, n in zip((self.reachable_range, self.reachable_doppler), self.shape, strict=True)
        )
        return Description(
            f"Gate: {n_range} range bins x {n_doppler} Doppler bins",
            {
                "range bins": range_text(self.range_bins),
                "Doppler bins": range_text(self.doppler_bins),
                "reachable": f"{reachable[0]} x {reachable[1]}",
            },
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of range and Doppler bins."""
        return self.range_bins.size, self.doppler_bins.size

    @property
    def reachable(self) -> Mask:
        """Mask of the gate's shape: cells in which a scatterer of the region can have its peak."""
        mask = np.zeros(self.shape, dtype=np.bool_)
        mask[self.reachable_range, self.reachable_doppler] = True
        return mask

    def index(self, bins: Bins) -> Bins:
        """Find absolute range and Doppler bins, each shape (n,), in arrays of the gate's shape."""
        return bins[0] - self.range_bins[0], bins[1] - self.doppler_bins[0]

    def surrounds(self, bins: Bins) -> Mask:
        """Tell the absolute range and Doppler bins, each shape (n,), that have all four neighbours."""
        (rows, columns), (n_rows, n_columns) = self.index(bins), self.shape
        return (rows >= 1) & (rows < n_rows - 1) & (columns >= 1) & (columns < n_columns - 1)

    def extend(self, n_range: int, n_doppler: int) -> Gate:
        """Add so many bins at either end; along an axis that wraps, they repeat those of the other end.

        Negative numbers remove outermost bins, as tapers do: reachable ones, too, without margins.
        """
        range_bins, reachable_range = _extend(self.range_bins, self.reachable_range, n_range)
        doppler_bins, reachable_doppler = _extend(self.doppler_bins, self.reachable_doppler, n_doppler)
        wraps = self.wraps[0] and n_range == 0, self.wraps[1] and n_doppler == 0
        return Gate(range_bins, doppler_bins, reachable_range, reachable_doppler, wraps)


def build_gate(
    system: System, base_station_m: Floats, region: Region, thinning: tuple[int, int] = (1, 1)
) -> Gate:
    """Derive the gate from the region and its speeds alone.

    Parameters
    ----------
    base_station_m : ndarray, shape (3,)
    thinning : (int, int)
        How often the map repeats among all bins (`isacbench.model.array.VirtualArray`).
    """
    range_bins, reachable_range = _reach(
        np.array(region.range_limits_m(base_station_m)) / system.range_bin_m,
        RANGE_MARGIN_BINS,
        system.n_subcarriers // thinning[0],
    )
    doppler_bins, reachable_doppler = _reach(
        np.array(region.speed_mps) / system.velocity_bin_mps,
        DOPPLER_MARGIN_BINS,
        system.n_symbols // thinning[1],
    )
    wraps = range_bins.size == system.n_subcarriers, doppler_bins.size == system.n_symbols
    return Gate(range_bins, doppler_bins, reachable_range, reachable_doppler, wraps)


def _extend(bins: Integers, reachable: slice, n: int) -> tuple[Integers, slice]:
    """Consecutive bins with n more at either end, or -n less, and the slice of the reachable ones."""
    extended = np.arange(bins[0] - n, bins[-1] + n + 1)
    return extended, slice(max(reachable.start + n, 0), min(reachable.stop + n, extended.size))


def _reach(limits_bins: Floats, margin: int, n_bins: int) -> tuple[Integers, slice]:
    """Bins nearest to all values between the limits, with margins where the map has room for them."""
    first, last = (int(bin_) for bin_ in np.rint(limits_bins))
    n_reachable = min(last - first + 1, n_bins)
    n_margin = min(2 * margin, n_bins - n_reachable)
    n_before = n_margin // 2
    bins = np.arange(first - n_before, first - n_before + n_reachable + n_margin)
    return bins, slice(n_before, n_before + n_reachable)
