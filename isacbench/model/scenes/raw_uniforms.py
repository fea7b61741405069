"""Uniform numbers that are the same on every machine and with every version of NumPy."""

from __future__ import annotations

import hashlib

import numpy as np

from isacbench.checked_arrays import Floats


def raw_uniforms(key_text: str, n: int) -> Floats:
    """Draw n uniform numbers, multiples of 2^-53 in [0, 1), from Philox 4x64-10, keyed by a text.

    NumPy may change its distributions between versions, the raw output of a
    bit generator it may not. The key is the first 128 bits of the SHA-256
    digest of the text. More numbers continue the same stream.

    References
    ----------
    Salmon, Moraes, Dror and Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011.
    """
    key = int.from_bytes(hashlib.sha256(key_text.encode()).digest()[:16], "little")
    raw = np.random.Philox(key=key).random_raw(n)
    return (raw >> np.uint64(11)).astype(np.float64) * 2.0**-53
