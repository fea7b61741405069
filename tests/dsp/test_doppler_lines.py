"""Doppler lines: found to a fraction of a bin, told apart, and separated into layers."""

import numpy as np
import pytest

from isacbench.dsp.doppler_lines import RESOLVED_BINS, doppler_layers
from isacbench.dsp.rangedoppler import GatedMap
from isacbench.model.gate import Gate
from isacbench.model.kernels import dirichlet

N_SYMBOLS = 64
GATE = Gate(np.arange(40, 60), np.arange(-12, 13), slice(3, 17), slice(5, 20))
WHOLE = Gate(np.arange(40, 60), np.arange(-32, 32), slice(3, 17), slice(0, 64), (False, True))
NOISE = 1e-3
ELEMENTS = (4, 4)


def gaussian(rng, shape):
    """Complex normal numbers of unit power."""
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)


def echo(line, amplitude, gate=GATE):
    """Echo (n_range, n_doppler, P, Q) of a line with amplitudes (n_range, P, Q)."""
    kernel = dirichlet(gate.doppler_bins, [line], N_SYMBOLS).conj()[:, 0] / np.sqrt(N_SYMBOLS)
    return amplitude[:, None] * kernel[:, None, None]


def echoes(lines, rows=slice(None), seed=0, gate=GATE):
    """Echo of each line, with amplitudes at random in some range bins and none elsewhere."""
    rng, n_range = np.random.default_rng(seed), gate.shape[0]
    present = np.zeros((n_range, 1, 1))
    present[rows] = 1
    return [echo(line, present * gaussian(rng, (n_range, *ELEMENTS)), gate) for line in lines]


def noisy(parts, gate=GATE, seed=1, noise=NOISE):
    """Map of echoes and noise."""
    rng = np.random.default_rng(seed)
    return GatedMap(sum(parts) + np.sqrt(noise) * gaussian(rng, (*gate.shape, *ELEMENTS)), gate)


def in_order(found):
    """Lines in every range bin, ascending."""
    assert found.counts.all()
    return np.sort(found.lines, axis=1)


@pytest.mark.parametrize("lines", [(-4.3,), (-5.2, 0.1, 3.45), (1.1, 1.6), (-6.9, 6.9)])
def test_lines_are_found_to_a_fiftieth_of_a_bin_at_30_db(lines):
    found = doppler_layers(noisy(echoes(lines)), N_SYMBOLS, NOISE)
    np.testing.assert_allclose(in_order(found), [lines] * GATE.shape[0], atol=0.02)
    np.testing.assert_array_equal(np.sort(found.home, axis=1), [np.rint(lines)] * GATE.shape[0])


def test_noise_holds_no_line_but_by_chance():
    none = [np.zeros((*GATE.shape, *ELEMENTS))]
    found = [doppler_layers(noisy(none, seed=seed), N_SYMBOLS, NOISE).lines for seed in range(20)]
    assert [lines.size for lines in found] == [0] * 20


def test_without_noise_there_are_as_many_lines_as_speeds():
    found = doppler_layers(GatedMap(sum(echoes((-2.2, 1.3))), GATE), N_SYMBOLS, 1e-20)
    np.testing.assert_allclose(in_order(found), [(-2.2, 1.3)] * GATE.shape[0], atol=0.02)


def test_speeds_nearer_than_lines_are_resolved_are_one_line_of_a_range_bin():
    found = doppler_layers(noisy(echoes((2.0, 2.0 + RESOLVED_BINS / 3))), N_SYMBOLS, NOISE)
    assert (found.counts.sum(axis=1) == 1).all()


def test_of_lines_too_near_to_be_told_apart_each_range_bin_has_its_own():
    near, far = echoes((1.0,), slice(0, 10))[0], echoes((1.25,), slice(10, 20), seed=3)[0]
    found = doppler_layers(noisy([near, far]), N_SYMBOLS, NOISE)
    assert (found.counts.sum(axis=1) == 1).all()
    own = found.lines[found.counts]
    np.testing.assert_allclose(own[4:8], 1.0, atol=0.02)
    np.testing.assert_allclose(own[12:16], 1.25, atol=0.02)


def test_a_line_follows_a_speed_that_changes_along_range():
    drift = 0.5 + 0.01 * np.arange(20)
    parts = [np.zeros((*GATE.shape, *ELEMENTS), dtype=np.complex128)]
    for row, line in enumerate(drift):
        parts.append(echoes((line,), slice(row, row + 1), seed=row)[0])
    found = doppler_layers(noisy(parts), N_SYMBOLS, NOISE)
    own = np.where(found.counts, found.lines, 0).sum(axis=1)
    np.testing.assert_allclose(own[3:17], drift[3:17], atol=0.02)


@pytest.mark.parametrize("gate", [GATE, WHOLE], ids=["gated", "whole"])
@pytest.mark.parametrize("lines", [(-3.1, 0.2, 2.75), (0.7, 1.2)])
def test_a_line_alone_is_its_echo_to_34_db(lines, gate):
    parts = echoes(lines, gate=gate)
    gated = noisy(parts, gate, noise=1e-9)
    found = doppler_layers(gated, N_SYMBOLS, 1e-9)
    for place, part in zip(lines, parts, strict=True):
        line, home = int(np.abs(found.lines[10] - place).argmin()), round(place)
        alone = found.alone(gated, line, home, 2)
        assert alone.gate.doppler_bins.tolist() == list(range(home - 2, home + 3))
        wanted = part[:, alone.gate.doppler_bins - gate.doppler_bins[0]]
        assert np.abs(alone.cells - wanted).max() < 0.02 * np.abs(part).max()


def test_bins_around_a_line_are_those_that_the_map_has_unless_its_end_is_next_to_its_beginning():
    for gate, bins in ((GATE, [10, 11, 12]), (WHOLE, [-34, -33, -32, -31, -30])):
        line = bins[len(bins) // 2] if gate is WHOLE else 12
        wide = Gate(
            gate.range_bins, gate.doppler_bins, gate.reachable_range, slice(0, gate.shape[1]), gate.wraps
        )
        gated = noisy(echoes((line,), gate=wide), wide)
        found = doppler_layers(gated, N_SYMBOLS, NOISE)
        alone = found.alone(gated, 0, line, 2)
        assert alone.gate.doppler_bins.tolist() == bins
        index = (np.array(bins) - wide.doppler_bins[0]) % wide.shape[1]
        np.testing.assert_array_equal(alone.cells, gated.cells[:, index])


def test_a_line_takes_nothing_in_range_bins_from_which_it_is_absent():
    near, far = echoes((0.4,), slice(0, 10))[0], echoes((0.9,), slice(10, 20), seed=3)[0]
    gated = noisy([near, far])
    found = doppler_layers(gated, N_SYMBOLS, NOISE)
    order = np.argsort(found.lines[10])
    np.testing.assert_allclose(found.lines[:, order], [(0.4, 0.9)] * GATE.shape[0], atol=0.03)
    power = np.mean(np.abs(found.layers) ** 2, axis=2)[:, order]
    # Least squares would give it 1.7 times the noise.
    assert power[:10, 1].mean() < 0.5 * NOISE
    assert power[10:, 0].mean() < 0.5 * NOISE


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_lines_do_not_depend_on_the_unit(scale):
    gated = noisy(echoes((-1.7, 3.3)))
    one, other = (
        doppler_layers(GatedMap(unit * gated.cells, GATE), N_SYMBOLS, unit**2 * NOISE)
        for unit in (1.0, scale)
    )
    np.testing.assert_allclose(one.lines, other.lines, rtol=1e-9)
    np.testing.assert_allclose(scale * one.layers, other.layers, rtol=1e-6, atol=1e-9 * scale)
