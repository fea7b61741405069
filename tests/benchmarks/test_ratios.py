"""Stages against the plain way to compute the same: ratios are printed and kept, times are not tested."""

import numpy as np
from isacbench_algorithms.detectors import CaCfar, OsCfar
from isacbench_algorithms.music2d import Music2d
from scipy.ndimage import rank_filter, uniform_filter

from isacbench.dsp.angles.aperture import Plane
from isacbench.dsp.angles.model_order import noise_edge
from isacbench.dsp.cfar.factors import ca_factor, osca_factor
from isacbench.model.kernels import steering

INSIDE = (slice(4, -4), slice(4, -4))
DENSE_SHAPE = 300, 150


class DenseMusic:
    """The product spectrum as the paper has it: complex noise subspaces on a grid of theta and phi.

    Steering vectors of the grid are computed once, and not timed.
    """

    def __init__(self, limits, n_elements, noise):
        self.n_subarray, self.noise = round(0.625 * n_elements), noise
        (lowest_u, highest_u), (lowest_w, highest_w) = limits
        phi = np.linspace(np.arccos(highest_w), np.arccos(lowest_w), DENSE_SHAPE[1])
        theta = np.linspace(
            np.arccos(highest_u / np.sin(phi).min()), np.arccos(lowest_u / np.sin(phi).min()), DENSE_SHAPE[0]
        )
        self.u = (np.cos(theta)[:, None] * np.sin(phi)).ravel()
        self.w = np.broadcast_to(np.cos(phi), DENSE_SHAPE).ravel()
        self.towards_u, self.towards_w = (
            steering(self.n_subarray, cosine).conj() for cosine in (self.u, self.w)
        )

    def peaks(self, snapshots):
        """Direction cosines (m, 2) of the local maxima in each cell."""
        along_u = self._noise_subspaces(snapshots)
        along_w = self._noise_subspaces(snapshots.transpose(0, 2, 1))
        found = []
        for u_basis, w_basis in zip(along_u, along_w, strict=True):
            null = self._null(self.towards_u, u_basis) * self._null(self.towards_w, w_basis)
            plane = null.reshape(DENSE_SHAPE)
            inner = plane[1:-1, 1:-1]
            deepest = (inner < plane[:-2, 1:-1]) & (inner < plane[2:, 1:-1])
            deepest &= (inner < plane[1:-1, :-2]) & (inner < plane[1:-1, 2:])
            index = np.ravel_multi_index(np.add(np.nonzero(deepest), 1), DENSE_SHAPE)
            found.append(np.stack([self.u[index], self.w[index]], axis=1))
        return found

    @staticmethod
    def _null(towards, basis):
        projection = towards @ basis
        return np.sum(projection.real**2 + projection.imag**2, axis=1)

    def _noise_subspaces(self, lines):
        n_sensors, n_snapshots = lines.shape[1:]
        n_shifts = n_sensors - self.n_subarray + 1
        shifted = [lines[:, k : k + self.n_subarray] for k in range(n_shifts)]
        forward = sum(x @ x.conj().transpose(0, 2, 1) for x in shifted) / (n_shifts * n_snapshots)
        backward = forward[:, ::-1, ::-1].conj()
        values, vectors = np.linalg.eigh((forward + backward) / 2)
        edge = self.noise * noise_edge(self.n_subarray, 2 * n_snapshots)
        orders = np.clip(np.count_nonzero(values > edge, axis=1), 1, 4)
        return [
            one[:, : self.n_subarray - order] for one, order in zip(vectors, orders.tolist(), strict=True)
        ]


def test_music_against_a_dense_grid(against, street):
    observation, snapshots, floor = street.observation, street.snapshots, street.detected.floor
    dense = DenseMusic(observation.cosine_limits, snapshots.shape[1], floor)
    kept = {}

    def by_grid():
        kept["peaks"] = dense.peaks(snapshots)

    def by_lines():
        lines = Plane(*snapshots.shape[1:]).lines(snapshots.astype(np.complex128))
        limits = observation.cosine_limits
        music = Music2d()
        return [
            music.line_music(*music.line_subspaces(line, floor), limit)
            for line, limit in zip(lines, limits, strict=True)
        ]

    along_u, along_w = against(by_lines, {"dense 300 x 150 grid": by_grid}, rounds=5)
    steps = np.array([np.ptp(dense.u) / DENSE_SHAPE[0], np.ptp(dense.w) / DENSE_SHAPE[1]])
    near = [
        (np.abs(peaks - [u, w]) < 2 * steps).all(axis=1).any()
        for cell, peaks in enumerate(kept["peaks"])
        for u in along_u.peaks.place[cell, along_u.peaks.found[cell]]
        for w in along_w.peaks.place[cell, along_w.peaks.found[cell]]
        if dense.u.min() < u < dense.u.max() and dense.w.min() < w < dense.w.max()
    ]
    assert np.mean(near) > 0.95


def test_os_mask_against_a_rank_filter(against, noise_map):
    footprint = np.ones((9, 9), dtype=bool)
    footprint[3:6, 3:6] = False
    kept = {}

    def by_sorting():
        kept["order"] = rank_filter(noise_map, 53, footprint=footprint)

    mask = against(
        lambda: OsCfar().detect(noise_map).mask, {"scipy.ndimage.rank_filter": by_sorting}, rounds=7
    )
    expected = noise_map > osca_factor(1e-3, ((54, 72),)) * kept["order"]
    assert np.array_equal(expected[INSIDE], mask[INSIDE])


def test_ca_against_uniform_filters(against, noise_map):
    kept = {}

    def window_and_guard():
        kept["sum"] = 81 * uniform_filter(noise_map, 9) - 9 * uniform_filter(noise_map, 3)

    found = against(
        lambda: CaCfar().detect(noise_map),
        {
            "scipy.ndimage.uniform_filter, once": lambda: uniform_filter(noise_map, 9),
            "scipy.ndimage.uniform_filter, window and guard region": window_and_guard,
        },
        rounds=30,
    )
    threshold = ca_factor(1e-3, 72) * kept["sum"][INSIDE] / 72
    np.testing.assert_allclose(found.threshold[INSIDE], threshold, rtol=1e-9)
