#!/usr/bin/env -S uv run --script
# /// script
# dependencies = ["isacbench[test]", "pyapril", "pyroomacoustics"]
# [tool.uv.sources]
# isacbench = { path = "../.." }
# ///
"""Time isacbench against what one would take instead, in turns, for the table of docs/performance.md.

    pip install pyapril pyroomacoustics                    # the others are in the extra `test`
    OPENBLAS_NUM_THREADS=1 python docs/scripts/peers.py    # minutes, 4 GB; writes results/reference/peers.csv
    python docs/scripts/tables.py

Times are of the processor, medians over rounds in which both take turns; the ratio is the median of the
ratios of the rounds. Before, both answers are tested to be the same.
"""

import csv
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from statistics import median
from time import process_time

import numpy as np
import scipy.fft
from doa_py import algorithm as doa
from doa_py.arrays import C, UniformLinearArray
from isacbench_algorithms import chain
from isacbench_algorithms.detectors import CaCfar, OsCfar
from isacbench_algorithms.music2d import Music2d
from numpy.lib.stride_tricks import sliding_window_view
from numpy.testing import assert_allclose, assert_array_equal
from pyapril.caCfar import CA_CFAR
from pyroomacoustics.doa import MUSIC
from scipy.ndimage import rank_filter, uniform_filter
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist
from stonesoup.metricgenerator.ospametric import GOSPAMetric
from stonesoup.types.state import State

from isacbench import PointCloud, load_scenario, observe, observe_cube, score
from isacbench.cubes.writing import FrameSimulator
from isacbench.dsp.angles.line_subspaces import line_eigenpairs, music_null_spectrum, real_steering
from isacbench.dsp.angles.planar_subspaces import planar_eigenpairs, unitary_esprit
from isacbench.metrics.assignment import gospa_m

PATH = Path(__file__).resolve().parents[2] / "results" / "reference" / "peers.csv"
SNR_DB, N_THREADS = 10.0, 2
LEAST_ROUNDS, MOST_ROUNDS, ENOUGH_S = 2, 51, 4.0


def compare(work, own, *others):
    """Yield a row for each of the others: its name, its package, its call and the test of both answers."""
    for name, package, other, agree in others:
        agree(own(), other())
        own_s, other_s = [], []
        while len(own_s) < LEAST_ROUNDS or (sum(own_s + other_s) < ENOUGH_S and len(own_s) < MOST_ROUNDS):
            for call, times_s in ((own, own_s), (other, other_s)):
                start_s = process_time()
                call()
                times_s.append(process_time() - start_s)
        ratio = median(theirs / ours for ours, theirs in zip(own_s, other_s, strict=True))
        numbers = [f"{float(f'{number:.2g}'):g}" for number in (median(own_s), median(other_s), ratio)]
        yield [work, name, f"{package} {version(package)}", *numbers]


def detectors():
    """Detectors on a map of noise and two echoes; at its edges others have windows of their own."""
    power = np.random.default_rng(1).exponential(size=(512, 128))
    power[100, 40], power[300, 90] = 60, 90
    ca, os = CaCfar(), OsCfar()
    found = ca.detect(power), os.detect(power)
    ca_factor, os_factor = (each.threshold[256, 64] / each.noise[256, 64] for each in found)
    training = np.ones((9, 9), dtype=bool)
    training[3:6, 3:6] = False
    pyapril, amplitude = CA_CFAR([4, 4, 1, 1], 10 * np.log10(ca_factor), power.shape), np.sqrt(power)

    def uniform():
        return power > ca_factor * (81 * uniform_filter(power, 9) - 9 * uniform_filter(power, 3)) / 72

    def rank():
        return power > os_factor * rank_filter(power, 53, footprint=training)

    def same(own, other):
        assert_array_equal(own[4:-4, 4:-4], other[4:-4, 4:-4])

    by_hand = "`uniform_filter`", "scipy", uniform, same
    april = "`CA_CFAR`", "pyapril", lambda: pyapril(amplitude)[0], same
    yield from compare("`ca` on a map of 512 x 128", lambda: ca.detect(power).mask, by_hand, april)
    by_hand = "`rank_filter`", "scipy", rank, same
    yield from compare("`os` on a map of 512 x 128", lambda: os.detect(power).mask, by_hand)


def directions():
    """Directions in the detected cells of the street; the others take one cell after the other."""
    observation, music2d = observe(load_scenario("street"), SNR_DB), Music2d()
    rdm = chain.read_map(observation, music2d)
    cells = chain.read_cells(rdm, chain.detect(rdm, music2d), music2d.snapshot_rules()[0]).own.astype(complex)
    n_cells, n_sensors, _ = cells.shape
    n_subarray, n_sources, cosine = 10, 2, np.linspace(*observation.cosine_limits[0], 201)
    lines = cells - cells.mean(axis=2, keepdims=True)  # as doa-py does
    line = UniformLinearArray(n_sensors, 0.5)
    # Without smoothing of its own: subarrays, forwards and backwards, are snapshots.
    forwards = sliding_window_view(lines, n_subarray, axis=1).reshape(n_cells, -1, n_subarray).swapaxes(1, 2)
    smoothed = np.concatenate([forwards, forwards[:, ::-1].conj()], axis=2)[:, :, None].repeat(2, axis=2)
    sensors = np.stack([-np.arange(n_subarray) / 2, np.zeros(n_subarray)])
    room = MUSIC(sensors, fs=2.0, nfft=2, c=1.0, azimuth=np.arccos(cosine))

    def nulls():
        steering, order = real_steering(n_subarray, cosine), np.full(n_cells, n_sources)
        return music_null_spectrum(line_eigenpairs(lines, n_subarray).vectors, order, steering)

    def doa_music():
        grid = np.arcsin(cosine)
        return [doa.smoothed_music(one, n_sources, line, C, grid, n_subarray, "rad") for one in lines]

    def room_music():
        spectra = []
        for snapshots in smoothed:
            room.locate_sources(snapshots, n_sources, freq_bins=[1])
            spectra.append(room.grid.values[::-1])
        return spectra

    def esprit():
        vectors = planar_eigenpairs(cells[:, None], (n_subarray, n_subarray), 1).vectors
        found = unitary_esprit(vectors.reshape(n_cells, n_subarray, n_subarray, 1))
        return np.hstack([found.u, found.w])

    def doa_esprit():
        return np.sin([[doa.esprit(one, 1, line, C, "rad")[0] for one in (cell, cell.T)] for cell in cells])

    def inverse(own, other):
        assert_allclose(own * other, 1, rtol=1e-6)

    def close(own, other):
        assert np.median(np.abs(own - other)) < cosine[1] - cosine[0]

    others = ("`smoothed_music`", "doa-py", doa_music), ("`MUSIC`", "pyroomacoustics", room_music)
    work = f"MUSIC spectra of {n_cells} cells along u"
    yield from compare(work, nulls, *((*other, inverse) for other in others))
    work = f"ESPRIT: u and w of the strongest echo of {n_cells} cells"
    yield from compare(work, esprit, ("`esprit` along u and along w", "doa-py", doa_esprit, close))


def clouds():
    """GOSPA of an image of the street, and of two dense clouds."""
    rng, street = np.random.default_rng(1), load_scenario("street")
    places_m = rng.uniform((0, 0, 0), (30, 30, 10), (2000, 3))
    dense = PointCloud(places_m), PointCloud(places_m + rng.normal(0, 0.3, places_m.shape))
    for truth, cloud in ((street.truth, Music2d().estimate(observe(street, SNR_DB))), dense):
        states = [[State(xyz, timestamp=datetime(2026, 1, 1)) for xyz in one.xyz] for one in (cloud, truth)]

        def by_hand(truth=truth, cloud=cloud):
            squared_m2 = np.minimum(cdist(truth.xyz, cloud.xyz, "sqeuclidean"), 1)
            matched_m2 = squared_m2[linear_sum_assignment(squared_m2)].sum()
            return np.sqrt(matched_m2 + abs(len(truth) - len(cloud)) / 2)

        def stone_soup(states=states):
            return GOSPAMetric(p=2, c=1.0).compute_gospa_metric(*states)[0].value["distance"]

        yield from compare(
            f"GOSPA of {len(truth)} and {len(cloud)} points",
            lambda truth=truth, cloud=cloud: gospa_m(truth, cloud),
            ("`cdist`, `linear_sum_assignment`", "scipy", by_hand, assert_allclose),
            ("`GOSPAMetric`", "stonesoup", stone_soup, assert_allclose),
        )


def frames():
    """A frame of the paper's size: its cells, and its image."""
    street = load_scenario("street-paper")
    frame = np.concatenate([block.astype(np.complex64) for block in FrameSimulator(street, SNR_DB).blocks()])
    gate = observe_cube(frame, street).gate
    in_gate = np.ix_(gate.range_bins % frame.shape[0], gate.doppler_bins % frame.shape[1])

    def gated():
        return observe_cube(frame, street, workers=N_THREADS)

    def same(own, other):
        assert_allclose(own, other, atol=1e-5 * np.abs(own).max())

    def good(own, other):
        assert min(score(street.truth, one, region=street.region)["recall"] for one in (own, other)) > 0.7

    by_hand = "`ifft`, `fft`", "scipy", lambda: transformed(frame)[in_gate], same
    yield from compare("range-Doppler cells of a frame, two threads", lambda: gated().cells, by_hand)
    program = "the paper's program, vectorised", "numpy", lambda: published_program(frame, gated()), good
    yield from compare("image of a frame, two threads", lambda: Music2d().estimate(gated()), program)


def transformed(frame):
    """Range-Doppler map of all elements."""
    ranges = scipy.fft.ifft(frame, axis=0, norm="ortho", workers=N_THREADS)
    return scipy.fft.fft(ranges, axis=1, norm="ortho", workers=N_THREADS, overwrite_x=True)


def published_program(frame, observation):
    """Image a frame as the program of arXiv 2310.06401 does: FFT, OSCA-CFAR, MUSIC on a grid, CA-CFAR.

    60000, 100 and 500 are added to its thresholds. `observation` places the points.
    """
    n_subcarriers, n_symbols, n_rows, _ = frame.shape
    cells, n_subarray = transformed(frame), n_rows // 2
    cells *= np.float32(np.sqrt(n_symbols / n_subcarriers))  # its transforms are not unitary
    power = np.fft.fftshift(np.abs(cells[:, :, 0, 0]) ** 2, axes=1)
    noise = uniform_filter(rank_filter(power, 5, size=(9, 1)), (1, 9))  # the 6th of 9 along range
    range_bin, column = np.nonzero(power > printed_factor(9) * noise + 60000)
    doppler_bin = column - n_symbols // 2
    detected = cells[range_bin, doppler_bin]

    grid_deg = np.meshgrid(60 + 0.2 * np.arange(1, 301), 60 + 0.2 * np.arange(1, 151), indexing="ij")
    theta, phi = np.deg2rad(grid_deg)
    cosines = np.cos(phi) * np.cos(theta), np.cos(phi) * np.sin(theta)
    spectra = np.ones((len(detected), *theta.shape))
    for lines, cosine in zip((detected[:, :, 0], detected[:, 0]), cosines, strict=True):
        towards = np.exp(-1j * np.pi * np.outer(np.arange(n_subarray), cosine))
        subarrays = sliding_window_view(lines, n_subarray, axis=1)
        values, vectors = np.linalg.eigh(subarrays.swapaxes(1, 2) @ subarrays.conj() / subarrays.shape[1])
        for spectrum, basis, n_sources in zip(spectra, vectors, eigenvalue_cfar(values), strict=True):
            beams = basis[:, : n_subarray - n_sources].conj().T @ towards
            spectrum /= np.sum(beams.real**2 + beams.imag**2, axis=0).reshape(theta.shape)

    points = []
    for cell, spectrum in enumerate(spectra):
        noise = (81 * uniform_filter(spectrum, 9) - 9 * uniform_filter(spectrum, 3)) / 72
        highest = np.argpartition(spectrum, -4, axis=None)[-4:]
        for place in highest[spectrum.flat[highest] > printed_factor(72) * noise.flat[highest] + 500]:
            u, w = (cosine.flat[place] for cosine in cosines)
            points.append((range_bin[cell], doppler_bin[cell], u, w, 1.0))
    return observation.cloud(*np.transpose(points))


def eigenvalue_cfar(values):
    """Numbers of ascending eigenvalues (n, L) above those near them, of which larger ones weigh less."""
    n_sources = np.zeros(len(values), dtype=int)
    for k in range(values.shape[1]):
        first = min(max(k - 2, 0), values.shape[1] - 5)
        sides = (0.8, values[:, first:k]), (0.2, values[:, k + 1 : first + 5])
        noise = sum(weight * side.mean(axis=1) for weight, side in sides if side.size)
        n_sources += values[:, k] > printed_factor(4) * noise + 100
    return np.minimum(n_sources, 3)


def printed_factor(n_training):
    """Threshold factor as the paper prints it."""
    return 1e-3 ** (-1 / n_training) - 1


if __name__ == "__main__":
    with PATH.open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["work", "other", "version", "own_s", "other_s", "ratio"])
        for matches in (detectors, directions, clouds, frames):
            table.writerows(matches())
