"""Bounds of range and direction, propagated to positions in space."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from isacbench.checked_arrays import Floats
from isacbench.dsp.bounds.echo_slopes import N_PARAMETERS
from isacbench.model.frame import Frame


def position_covariance(
    frame: Frame, range_m: ArrayLike, u: ArrayLike, w: ArrayLike, covariance: ArrayLike
) -> Floats:
    """Propagate covariances to positions in space, to first order.

    Parameters
    ----------
    range_m, u, w : array_like, shape (K,)
        Places of the scatterers.
    covariance : array_like, shape (K, 4, 4) or (4, 4)
        Of (R, v, u, w), as in `Bound`.

    Returns
    -------
    ndarray of float64, shape (K, 4, 4)
        Of (x, y, z, v), in m and m/s. As in `Bound`, a scatterer without a bound has
        infinite variances and NaN elsewhere. Of x, y and z all is NaN where the
        frame is singular or blind.

    Examples
    --------
    A street's scatterer, seen by a panel: x is uncertain by R times u.

    >>> from isacbench.dsp.bounds import single_bound
    >>> from isacbench.model.frame import PanelFrame
    >>> from isacbench.model.numerology import System
    >>> bound = single_bound(System(), (16, 16), snr=1e-3)
    >>> xyzv = position_covariance(PanelFrame(), [90.0], [0.01], [0.2], bound.covariance)
    >>> round(float(np.sqrt(xyzv[0, 0, 0]) / (90 * bound.u)), 3)
    1.0
    """
    jacobian = frame.offset_jacobian(range_m, u, w)
    into_space = np.zeros((len(jacobian), N_PARAMETERS, N_PARAMETERS))
    into_space[:, :3, [0, 2, 3]] = jacobian
    into_space[:, 3, 1] = 1
    covariance = np.broadcast_to(np.asarray(covariance, dtype=np.float64), into_space.shape)
    known = np.all(np.isfinite(covariance), axis=(1, 2))
    transported = np.full(into_space.shape, np.nan)
    transported[:, np.arange(N_PARAMETERS), np.arange(N_PARAMETERS)] = np.inf
    into_space = into_space[known]
    transported[known] = into_space @ covariance[known] @ into_space.transpose(0, 2, 1)
    return transported
