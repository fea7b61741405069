"""Snapshots of an array that tests of plane waves share: sources, and noise."""

import numpy as np
from hypothesis import strategies as st

from isacbench.model.kernels import steering


def noise(*shape, seed=0):
    """White complex noise of unit power."""
    rng = np.random.default_rng(seed)
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)


def responses(u, w, shape=(16, 16)):
    """Responses (K, P, Q) of the elements to unit waves."""
    return steering(shape[0], u)[:, :, None] * steering(shape[1], w)[:, None]


def snapshot(u, w, gain, shape=(16, 16)):
    """Noise-free snapshot (1, P, Q)."""
    return np.tensordot(gain, responses(u, w, shape), 1)[None]


def plain_covariance(snapshot, subarray):
    """Forward-backward covariance (L M, L M) of a snapshot (P, Q), smoothed over subarrays by plain loops."""
    (n_p, n_q), (n_u, n_w) = snapshot.shape, subarray
    total, count = np.zeros((n_u * n_w, n_u * n_w), dtype=complex), 0
    for p in range(n_p - n_u + 1):
        for q in range(n_q - n_w + 1):
            x = snapshot[p : p + n_u, q : q + n_w].ravel()
            total += np.outer(x, x.conj()) + np.outer(x[::-1].conj(), x[::-1])
            count += 2
    return total / count


@st.composite
def separate_sources(draw):
    """One to four sources in as many columns and rows, more than a Rayleigh cell of half the array apart."""
    k = draw(st.integers(1, 4))
    slots = np.array([-0.75, -0.25, 0.25, 0.75])
    u, w = (
        slots[draw(st.permutations(range(4)))[:k]]
        + np.array(draw(st.lists(st.floats(-0.1, 0.1), min_size=k, max_size=k)))
        for _ in range(2)
    )
    gain = [draw(st.floats(0.5, 2)) * np.exp(1j * draw(st.floats(0, 2 * np.pi))) for _ in range(k)]
    return u, w, np.array(gain)
