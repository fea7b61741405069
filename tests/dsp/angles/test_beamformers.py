"""Angular spectra of beamformers, against plain loops over complex steering vectors."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.angles.beamformers import bartlett_spectrum, capon_spectrum, iaa_spectrum
from isacbench.dsp.angles.peaks import cosine_samples
from isacbench.dsp.angles.planar_spectra import AngularSpectrum
from isacbench.model.kernels import steering
from tests.dsp.plane_wave_data import noise, plain_covariance

U, W = np.linspace(-0.5, 0.4, 7), np.linspace(-0.3, 0.6, 6)
FINE = cosine_samples((-0.5, 0.5), 1 / 32)


def waves(shape, *places, level=0.0, seed=0):
    """Snapshot (1, P, Q) of plane waves (u, w, amplitude) and noise of a power."""
    echo = sum(g * np.outer(steering(shape[0], u), steering(shape[1], w)) for u, w, g in places)
    return (echo + np.sqrt(level) * noise(*shape, seed=seed))[None]


def direction(shape, u, w):
    """Steering vector (P Q,) of a direction."""
    return np.kron(steering(shape[0], u), steering(shape[1], w))


def on_grid(function):
    """Values (7, 6) of a function of a direction."""
    return np.array([[function(u, w) for w in W] for u in U])


@pytest.mark.parametrize("shape", [(5, 4), (4, 7)])
def test_bartlett_s_power_is_that_of_a_sum_over_all_elements(shape):
    x = noise(1, *shape)

    def power(u, w):
        total = sum(np.exp(1j * np.pi * (p * u + q * w)) * x[0, p, q] for p, q in np.ndindex(shape))
        return abs(total) ** 2 / (shape[0] * shape[1]) ** 2

    np.testing.assert_allclose(bartlett_spectrum(x, U, W).power[0], on_grid(power), rtol=1e-10)


@pytest.mark.parametrize(("shape", "subarray"), [((6, 5), (3, 3)), ((5, 6), (4, 2)), ((4, 4), (4, 4))])
def test_capon_s_power_is_that_of_the_inverse_of_the_smoothed_covariance(shape, subarray):
    x, loading = waves(shape, (0.2, 0.1, 2.0), (-0.3, 0.4, 1j), level=0.1), 0.3
    # The correlation of a time-reversed conjugate is that of the wave itself.
    inverse = np.linalg.inv(plain_covariance(x[0], subarray) + loading * np.eye(np.prod(subarray)))

    def power(u, w):
        a = direction(subarray, u, w)
        return 1 / np.vdot(a, inverse @ a).real

    found = capon_spectrum(x, subarray, loading, U, W).power[0]
    np.testing.assert_allclose(found, on_grid(power), rtol=1e-8)


def plain_iaa(x, noise_power, n_iterations, u, w):
    """Iterative adaptive approach as printed, with full matrices and loops."""
    shape, y = x.shape, x.ravel()
    grid = [direction(shape, one, other) for one in u for other in w]
    power = [abs(np.vdot(a, y)) ** 2 / y.size**2 for a in grid]
    for _ in range(n_iterations):
        model = noise_power * np.eye(y.size, dtype=complex)
        for p, a in zip(power, grid, strict=True):
            model += p * np.outer(a, a.conj())
        inverse = np.linalg.inv(model)
        power = [abs(np.vdot(a, inverse @ y) / np.vdot(a, inverse @ a)) ** 2 for a in grid]
    return np.reshape(power, (len(u), len(w)))


@pytest.mark.parametrize("n_iterations", [1, 2, 8])
@pytest.mark.parametrize("shape", [(5, 4), (3, 6)])
def test_the_iterative_adaptive_approach_is_that_of_full_matrices(shape, n_iterations):
    x = waves(shape, (0.2, 0.1, 2.0), (-0.3, 0.4, 1j), level=0.1)
    # All directions: no dimension of the array is left out.
    u, w = np.linspace(-1, 1, 11), np.linspace(-1, 1, 13)
    found = iaa_spectrum(x, 0.1, n_iterations, u, w).power[0]
    np.testing.assert_allclose(found, plain_iaa(x[0], 0.1, n_iterations, u, w), rtol=1e-8, atol=1e-12)


def test_the_iterative_adaptive_approach_takes_cells_with_hardly_any_noise_and_empty_ones():
    cells = np.concatenate([waves((16, 16), (0.1, 0.2, 1.0)), np.zeros((1, 16, 16))])
    u = np.linspace(-0.3, 0.5, 17)
    power = iaa_spectrum(cells, 1e-20, 15, u, u).power
    assert np.isfinite(power).all()
    assert power[0].max() == pytest.approx(1, abs=0.1)


def test_dimensions_that_no_direction_of_the_grid_reaches_hardly_matter():
    x = waves((12, 12), (0.1, 0.2, 2.0), (-0.1, 0.05, 1j), level=0.1)
    u, w = np.linspace(-0.2, 0.3, 9), np.linspace(-0.1, 0.3, 8)
    plain = plain_iaa(x[0], 0.1, 5, u, w)
    np.testing.assert_allclose(iaa_spectrum(x, 0.1, 5, u, w).power[0], plain, atol=0.02 * plain.max())


def test_the_iterative_adaptive_approach_sharpens_the_spectrum_of_two_waves():
    x = waves((16, 16), (0.11, 0.13, 1.0), (0.11 + 0.1, 0.13, 1j), level=1e-3)
    u = cosine_samples((-0.3, 0.5), 2 / 16 / 3)
    before, after = (iaa_spectrum(x, 1e-3, n, u, u) for n in (0, 8))
    assert np.count_nonzero(after.power > 0.01) < 0.2 * np.count_nonzero(before.power > 0.01)
    found = after.waves(15.0, 6)
    assert found.found.sum() == 2
    np.testing.assert_allclose(np.sort(found.u[0, :2]), [0.11, 0.21], atol=0.02)


SPECTRA = {
    "bartlett": lambda x: bartlett_spectrum(x, FINE, FINE),
    "capon": lambda x: capon_spectrum(x, (10, 10), 1e-6, FINE, FINE),
}


@pytest.mark.parametrize("name", SPECTRA)
@given(u=st.floats(-0.45, 0.45), w=st.floats(-0.45, 0.45))
def test_a_lone_wave_is_found_where_it_is(name, u, w):
    found = SPECTRA[name](waves((16, 16), (u, w, 1.0))).waves(10.0, 4)
    assert found.found.sum() == 1
    assert abs(found.u[0, 0] - u) < 1e-7
    assert abs(found.w[0, 0] - w) < 1e-7


def test_capon_resolves_two_waves_that_have_one_maximum_in_bartlett_s_spectrum():
    x = waves((16, 16), (0.0, 0.1, 1.0), (0.1, 0.1, 1j), level=1e-4)
    assert [SPECTRA[name](x).waves(10.0, 4).found.sum() for name in SPECTRA] == [1, 2]


@pytest.mark.parametrize("name", [*SPECTRA, "iaa"])
def test_a_spectrum_without_power_has_no_peaks(name):
    spectrum = SPECTRA.get(name, lambda x: iaa_spectrum(x, 1e-3, 3, FINE, FINE))
    assert not spectrum(np.zeros((1, 16, 16), dtype=complex)).waves(10.0, 4).found.any()


def test_the_flat_spectrum_of_an_element_alone_has_no_peaks():
    one_element = np.zeros((1, 16, 16), dtype=complex)
    one_element[0, 3, 5] = 2.0
    assert not bartlett_spectrum(one_element, FINE, FINE).waves(10.0, 4).found.any()


@given(snr=st.sampled_from([1e2, 1e3, 1e4]), shift=st.floats(0, 1 / 32))
def test_two_equal_waves_are_both_peaks_of_capon_s_spectrum_wherever_the_samples_lie(snr, shift):
    places = [(-0.1 + shift, 0.1, 1.0), (0.15 + shift, 0.1, 1j)]
    x = waves((16, 16), *places, level=1 / snr)
    found = capon_spectrum(x, (10, 10), 1 / snr, FINE, FINE).waves(15.0, 6)
    for u, w, _ in places:
        assert np.hypot(found.u - u, found.w - w)[found.found].min() < 0.01


def test_capon_takes_snapshots_of_single_precision():
    x = waves((8, 8), (0.1, 0.2, 1.0)).astype(np.complex64)
    assert capon_spectrum(x, (5, 5), 0.0, FINE, FINE).waves(10.0, 4).found.sum() == 1


def test_peaks_beyond_the_dynamic_range_or_on_the_border_are_left_out():
    power = np.full((1, 9, 9), 1e-6)
    power[0, 2, 2], power[0, 6, 6], power[0, 0, 5] = 1.0, 0.01, 5.0
    grid = np.linspace(0, 0.8, 9)
    spectrum = AngularSpectrum(grid, grid, power)
    assert spectrum.waves(15.0, 4).found.sum() == 1
    both = spectrum.waves(25.0, 4)
    np.testing.assert_allclose(both.u[0, :2], [0.2, 0.6])
    assert spectrum.waves(25.0, 1).found.sum() == 1
