"""Types of arrays in signal processing."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complex = NDArray[np.complexfloating[Any, Any]]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]
