"""Arrays of frozen dataclasses, frozen as well."""

from __future__ import annotations

import numpy as np
from numpy.typing import DTypeLike

from isacbench.checked_arrays import checked_array


def freeze_arrays(owner: object, *names: str, dtype: DTypeLike = np.float64) -> None:
    """Replace attributes of a frozen dataclass by read-only copies; called in its ``__post_init__``.

    Parameters
    ----------
    owner : object
        Instance of the dataclass.
    *names : str
        Attributes that hold arrays or what arrays are made of.
    dtype : dtype
        Type of the copies.

    Raises
    ------
    InputError
        If a conversion would lose something (`isacbench.checked_arrays`).
    """
    for name in names:
        values = checked_array(name, getattr(owner, name), dtype).astype(dtype, order="K", copy=True)
        values.setflags(write=False)
        object.__setattr__(owner, name, values)
