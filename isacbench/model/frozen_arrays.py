"""Arrays of frozen dataclasses, frozen as well."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import DTypeLike


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
    """
    for name in names:
        values = np.array(getattr(owner, name), dtype=dtype)
        values.setflags(write=False)
        object.__setattr__(owner, name, values)
