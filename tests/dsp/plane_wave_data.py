"""Snapshots of an array that tests of plane waves share: sources, and noise."""

import numpy as np
from hypothesis import strategies as st

from isacbench.dsp.angles.plane_waves import PlaneWaves
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


def waves(u, w):
    """Plane waves (n, k) of all directions given, of one cell or of several."""
    u, w = (np.atleast_2d(np.asarray(cosine, dtype=float)) for cosine in (u, w))
    return PlaneWaves(u, w, np.ones(u.shape, dtype=bool))


def pairs_of(waves):
    """Pairs (u, w) found in the first cell, sorted."""
    return sorted(zip(waves.u[0][waves.found[0]], waves.w[0][waves.found[0]], strict=True))


def least_squares(snapshots, u, w):
    """Amplitudes (K, s) of waves in snapshots (s, P, Q), and the power that they leave, by dense algebra."""
    dense = responses(u, w, snapshots.shape[1:]).reshape(len(u), -1).T
    data = snapshots.reshape(len(snapshots), -1).T
    amplitude = np.linalg.lstsq(dense, data, rcond=None)[0]
    return amplitude, np.sum(np.abs(data - dense @ amplitude) ** 2)


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


def unitary_transform(n):
    """Q of Huarng and Yeh, element by element: pairs of mirrored sensors become sums and differences."""
    half = n // 2
    q = np.zeros((n, n), dtype=complex)
    for i in range(half):
        mirror = n - 1 - i
        q[i, i] = q[mirror, i] = 1 / np.sqrt(2)
        q[i, n - half + i], q[mirror, n - half + i] = 1j / np.sqrt(2), -1j / np.sqrt(2)
    if n % 2:
        q[half, half] = 1
    return q


@st.composite
def separate_sources(draw):
    """One to four sources in as many columns and rows, more than a Rayleigh cell of half the array apart."""
    k = draw(st.integers(1, 4))
    slots = np.array([-0.75, -0.25, 0.25, 0.75])
    shifts = st.lists(st.floats(-0.1, 0.1), min_size=k, max_size=k)
    u, w = (slots[draw(st.permutations(range(4)))[:k]] + np.array(draw(shifts)) for _ in range(2))
    gain = [draw(st.floats(0.5, 2)) * np.exp(1j * draw(st.floats(0, 2 * np.pi))) for _ in range(k)]
    return u, w, np.array(gain)
