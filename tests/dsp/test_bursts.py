"""Doppler kernels of gapped frames against plain sums over their symbols."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.bursts import SymbolBursts, symbol_bursts, whole_frame
from isacbench.dsp.windows import taper
from isacbench.errors import InputError
from isacbench.model.kernels import dirichlet, dirichlet_slopes
from isacbench.model.numerology import System, resource_elements
from tests.conftest import each_prs, refusal

PRS = symbol_bursts(System(), "prs")


def sensed_symbols(bursts):
    starts = bursts.first + bursts.spacing * np.arange(bursts.n_bursts)
    return (starts[:, None] + np.arange(bursts.length)).ravel()


def summed(bursts, distance):
    """The kernel and two derivatives as sums over symbols, referred to their middle."""
    symbols = sensed_symbols(bursts)
    rate = 2 * np.pi / bursts.n_symbols * (symbols - symbols.mean())
    phase = np.multiply.outer(distance, rate)
    return np.cos(phase).mean(-1), (-rate * np.sin(phase)).mean(-1), (-(rate**2) * np.cos(phase)).mean(-1)


@st.composite
def some_bursts(draw):
    length, gap, n_bursts = draw(st.integers(1, 12)), draw(st.integers(1, 50)), draw(st.integers(2, 5))
    before, after = draw(st.integers(0, 9)), draw(st.integers(0, 9))
    spacing = length + gap
    n_symbols = before + (n_bursts - 1) * spacing + length + after
    return SymbolBursts(n_symbols, before, length, n_bursts, spacing)


@given(some_bursts(), st.lists(st.floats(-40, 40), min_size=1, max_size=5))
def test_kernel_and_slopes_are_sums_over_the_symbols(bursts, distance):
    distance = np.array(distance)
    for value, expected in zip(bursts.slopes(distance), summed(bursts, distance), strict=True):
        np.testing.assert_allclose(value, expected, atol=1e-6)


@given(some_bursts(), st.floats(-40, 40), st.integers(-300, 300))
def test_a_centred_echo_is_the_response(bursts, place, first):
    bins, symbols = np.arange(first, first + 9), np.arange(bursts.n_symbols)
    n = bursts.n_symbols
    # Amplitudes are those behind a division, of mean 1 over the frame; the phase is that at the middle.
    weight = np.isin(symbols, sensed_symbols(bursts)) * bursts.redundancy
    echo = weight * np.exp(2j * np.pi * place / n * (symbols + bursts.delay_symbols))
    cells = np.exp(-2j * np.pi / n * np.outer(bins, symbols)) @ echo / np.sqrt(n)
    centred = bursts.centred(cells[None], bins)[0]
    np.testing.assert_allclose(centred, bursts.response(bins, [place])[:, 0], atol=1e-6 * np.sqrt(n))


@given(st.integers(1, 200), st.lists(st.floats(-300, 300), min_size=1, max_size=5))
def test_a_whole_frame_has_the_dirichlet_kernel(n, distance):
    whole, distance = whole_frame(n), np.array(distance)
    expected = dirichlet([0, 3], distance, n).conj()
    np.testing.assert_allclose(whole.response([0, 3], distance), expected, atol=1e-12 * np.sqrt(n))
    np.testing.assert_array_equal(whole.slopes(distance), dirichlet_slopes(distance, n))
    cells = np.ones((2, 3, 1), complex)
    assert whole.centred(cells, [0, 1, 2]) is cells
    assert whole.redundancy == 1


@given(st.floats(-16, 16))
def test_sidelobes_lie_below_their_bound(distance):
    # The bound takes the sine between two lobes for its angle, π/2 at most.
    bound = np.pi / 2 / PRS.sidelobe_drop(np.array(distance))
    assert abs(PRS.slopes(distance)[0]) <= bound + 1e-12


@given(st.integers(-4, 4), st.floats(-0.25, 0.25))
def test_grating_lobes_lie_below_their_bound_even_where_peaks_are_read_beside_them(lobe, error):
    height = abs(PRS.slopes(4.0 * lobe)[0])
    assert height <= 1 / PRS.sidelobe_drop(np.array(4 * lobe + error)) + 1e-12


@given(st.floats(0, 1))
def test_two_neighbouring_bins_tell_where_an_echo_is(offset):
    for bursts in (PRS, SymbolBursts(32, 2, 12)):
        own, other = np.abs(bursts.slopes(np.array([offset, 1 - offset]))[0])
        assert bursts.fractional_bin(own, other) == pytest.approx(offset, abs=1e-4)


def test_grating_lobes_of_the_prs_have_their_heights():
    lobes = PRS.lobe_period * np.arange(5)
    height_db = 20 * np.log10(np.abs(PRS.slopes(lobes)[0]))
    np.testing.assert_allclose(height_db, [0, -0.66, -2.79, -6.97, -15.78], atol=0.01)
    np.testing.assert_allclose(PRS.to_lobe(lobes + 0.25), 0.25)


@pytest.mark.parametrize("n_symbols", [3, 14, 15, 32, 56, 62, 70, 112, 223, 224])
def test_bursts_are_those_of_the_resource_elements(n_symbols):
    system = System(n_subcarriers=16, n_symbols=n_symbols)
    bursts = symbol_bursts(system, "prs")
    symbols = np.flatnonzero(resource_elements(system, "prs").any(axis=0))
    np.testing.assert_array_equal(sensed_symbols(bursts), symbols)
    assert bursts.delay_symbols == (n_symbols - 1) / 2 - symbols.mean()
    assert bursts.redundancy == n_symbols / symbols.size


@given(each_prs(), st.integers(1, 160))
def test_bursts_of_any_prs_are_those_of_its_slots(prs, n_symbols):
    system = System(n_subcarriers=16, n_symbols=n_symbols, prs=prs)
    symbols = np.flatnonzero(resource_elements(system, "prs").any(axis=0))
    if not symbols.size:
        assert n_symbols <= 14 * prs.offset + prs.first_symbol
        assert f"system.n_symbols = {n_symbols}, sensing = 'prs'" in refusal(symbol_bursts, system, "prs")
        return
    bursts = symbol_bursts(system, "prs")
    np.testing.assert_array_equal(sensed_symbols(bursts), symbols)
    if bursts.n_bursts > 1:
        assert (bursts.length, bursts.spacing) == (prs.n_symbols, 14 * prs.period)
        lobe_mps = bursts.lobe_period * system.velocity_bin_mps
        assert lobe_mps == pytest.approx(system.wavelength_m / (2 * prs.period * 14 * system.symbol_time_s))


def test_a_frame_without_prs_is_refused():
    system = System(n_subcarriers=16, n_symbols=1)
    with pytest.raises(InputError, match=r"n_symbols = 1.*sensing = 'prs'"):
        symbol_bursts(system, "prs")
    assert symbol_bursts(system, "all").is_whole_frame


def test_single_symbols_have_lobes_as_high_as_the_peak():
    equal = PRS.with_equal_lobes
    np.testing.assert_allclose(np.abs(equal.slopes(4.0 * np.arange(5))[0]), 1)
    np.testing.assert_array_equal(equal.sidelobe_drop(4.0 * np.arange(5)), 1)
    assert whole_frame(8).with_equal_lobes == whole_frame(8)


@pytest.mark.parametrize(
    ("bursts", "dense"),
    [
        (SymbolBursts(224, 0, 224), True),
        (SymbolBursts(560, 1, 12, 40, 14), True),
        # Four lobes a frame; a single burst; bursts in a part of the frame.
        (SymbolBursts(224, 1, 12, 4, 56), False),
        (SymbolBursts(224, 30, 4), False),
        (SymbolBursts(560, 1, 12, 20, 14), False),
    ],
)
def test_a_taper_acts_on_dense_bursts_as_on_a_whole_frame(bursts, dense):
    assert bursts.are_dense == dense
    # What a Hann window leaves of an echo, in its bins and between them.
    bins = np.arange(-20, 21)
    seen = taper(bursts.response(bins, [1 / 3])[:, 0], "hann", axis=0)
    whole = taper(whole_frame(bursts.n_symbols).response(bins, [1 / 3])[:, 0], "hann", axis=0)
    assert np.allclose(np.abs(seen), np.abs(whole), atol=2e-2 * np.abs(whole).max()) == dense
