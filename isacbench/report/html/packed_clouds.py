"""Point clouds in the compact form of a page, and the rule by which a page holds only some of them."""

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from isacbench.charts import nearest_values

MOST_POINTS = 1_500_000
"""Points of estimated clouds in a page: 7 MB in it, at 3.6 bytes a point before base64."""

SHOWN_SNR_DB = 10.0
"""SNR at which a page opens, or the nearest one that the run has."""

LEVELS = 65_535
"""Steps between the smallest and the largest coordinate of a cloud: 1.5 mm of 100 m."""

POWER_LEVELS = 255

WEAKEST = 1e-30
"""Power below which all is as weak."""


def pack_clouds(points: NDArray[np.float64], n_points: NDArray[np.int64]) -> bytes:
    """Quantise clouds, each between its own limits, for compression and for a quick start of a page.

    `points` has x, y, z in m, v in m/s and power of one cloud after the other. Returned is little-endian
    float32 of shape (n, 10): lowest value and step of x, y, z, v, and of the power in dB; then bytes, of all
    points: high and low byte of x, of y, of z, of v, and one byte of power.
    """
    values = points.copy()
    values[:, 4] = 10 * np.log10(np.maximum(points[:, 4], WEAKEST))
    limits, filled = np.zeros((len(n_points), 10), dtype="<f4"), np.flatnonzero(n_points)
    levels = np.array([LEVELS, LEVELS, LEVELS, LEVELS, POWER_LEVELS])
    if filled.size:
        first = (np.cumsum(n_points) - n_points)[filled]
        lowest = np.minimum.reduceat(values, first)
        limits[filled, 0::2] = lowest
        limits[filled, 1::2] = (np.maximum.reduceat(values, first) - lowest) / levels
    own = np.repeat(limits.astype(np.float64), n_points, axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        steps = np.nan_to_num((values - own[:, 0::2]) / own[:, 1::2], posinf=0.0, neginf=0.0)
    whole = np.clip(np.rint(steps), 0, levels).astype(np.uint16)
    planes = [plane for axis in range(4) for plane in (whole[:, axis] >> 8, whole[:, axis] & 255)]
    return limits.tobytes() + b"".join(plane.astype(np.uint8).tobytes() for plane in [*planes, whole[:, 4]])


def choose_clouds(
    records: pd.DataFrame,
    n_points: NDArray[np.int64],
    first: NDArray[np.bool_] | None = None,
    most_points: int = MOST_POINTS,
) -> NDArray[np.bool_]:
    """Choose the clouds that a page holds, the most wanted ones first.

    The order is: the clouds that the caller wants first; of every scene and
    estimator the first trial at the SNR nearest 10 dB; its cell of largest
    deviation; the first trial at other SNRs; then further trials.

    `first` are the rows whose clouds the caller wants; `most_points` is the sum of all clouds.
    """
    if n_points.sum() <= most_points:
        return np.ones(len(records), dtype=np.bool_)
    trial_number = np.searchsorted(np.unique(records["trial"]), records["trial"])
    (shown_db,) = nearest_values(sorted(records["snr_db"].unique()), [SHOWN_SNR_DB])
    order = 2 + trial_number
    order[(trial_number == 0) & (records["snr_db"] == shown_db).to_numpy()] = 0
    by_deviation = np.argsort(-records["deviation"].fillna(-np.inf).to_numpy(), kind="stable")
    is_repeated = records.iloc[by_deviation].duplicated(["scenario", "estimator", "params"]).to_numpy()
    worst = by_deviation[~is_repeated]
    order[worst] = np.minimum(order[worst], 1)
    if first is not None:
        order[first] = -1
    # One cloud that is too large by itself must not keep the others out.
    n_wanted = np.where(n_points > most_points // 2, most_points + 1, n_points)
    sequence = np.argsort(np.where(n_wanted > most_points, len(records) + order.max(), order), kind="stable")
    chosen = np.zeros(len(records), dtype=np.bool_)
    chosen[sequence] = np.cumsum(n_wanted[sequence]) <= most_points
    return chosen
