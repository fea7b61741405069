import math
from fractions import Fraction
from functools import partial
from itertools import product

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy import special, stats

from isacbench.dsp.cfar import trimmed_factors
from isacbench.dsp.cfar.factors import (
    ca_factor,
    ca_rate,
    chosen_half_rate,
    goca_factor,
    osca_factor,
    osca_rate,
    paper_factor,
    soca_factor,
)
from isacbench.dsp.cfar.trimmed_factors import many_looks_rate, tm_factor
from isacbench.errors import InputError
from tests.conftest import few

INSIDE = ((6, 9),) * 8 + ((6, 8),)
OUTSIDE = ((6, 9),) * 9
PFAS = st.floats(-12, -0.05).map(lambda exponent: 10**exponent)
COLUMNS = (
    st.integers(1, 90)
    .flatmap(lambda n: st.tuples(st.integers(1, n), st.just(n)))
    .flatmap(lambda column: st.tuples(st.just(column), st.integers(1, 12)))
)


def one_look_rate(factor, columns):
    """Multiplies the Laplace transforms of exponential order statistics, cell by cell."""
    s = factor / len(columns)
    rate = 1.0
    for rank, n_cells in columns:
        for i in range(rank):
            rate *= (n_cells - i) / (n_cells - i + s)
    return rate


def gamma_density(x, looks):
    """Gives the density of a power of mean 1; frozen laws of scipy take a hundred times as long."""
    return looks * np.exp(special.xlogy(looks - 1, looks * x) - looks * x - special.gammaln(looks))


def order_density(x, rank, n_cells, looks):
    ways = n_cells * math.comb(n_cells - 1, rank - 1)
    below, above = special.gammainc(looks, looks * x), special.gammaincc(looks, looks * x)
    return ways * gamma_density(x, looks) * below ** (rank - 1) * above ** (n_cells - rank)


def convolved_rate(factor, columns, looks):
    """Convolves the densities of the columns; all terms are positive: small rates keep their digits."""
    power, step = np.linspace(0, 8, 2001, retstep=True)
    law = np.ones(1)
    for rank, n_cells in columns:
        law = np.convolve(law, step * order_density(power, rank, n_cells, looks))
    estimate = step * np.arange(law.size) / len(columns)
    return law @ special.gammaincc(looks, looks * factor * estimate)


@pytest.mark.parametrize(
    ("factor", "cells", "expected"),
    [
        *((ca_factor, 72, 7.249980), (goca_factor, (36, 36), 6.710225), (soca_factor, (36, 36), 8.198775)),
        *((osca_factor, INSIDE, 7.262139), (osca_factor, OUTSIDE, 7.437354)),
        (osca_factor, ((54, 72),), 5.448701),
    ],
)
def test_factors_equal_the_known_vectors(factor, cells, expected):
    assert factor(1e-3, cells) == pytest.approx(expected, abs=6e-7)


@given(PFAS, st.integers(1, 5000), st.integers(1, 1024))
@example(1e-12, 5000, 1)
@example(0.5, 5000, 1)
def test_ca_factor_is_the_quantile_of_the_f_distribution(pfa, n_training, looks):
    rate = stats.f.sf(ca_factor(pfa, n_training, looks), 2 * looks, 2 * looks * n_training)
    assert rate == pytest.approx(pfa, rel=1e-9)


@few
@given(PFAS, COLUMNS, COLUMNS)
def test_osca_factor_of_one_look_gives_the_rate_of_the_product_formula(pfa, some, others):
    columns = (some[0],) * some[1] + (others[0],) * others[1]
    assert one_look_rate(osca_factor(pfa, columns), columns) == pytest.approx(pfa, rel=1e-8)


@pytest.mark.parametrize("looks", [1, 2, 16, 256, 1024])
@pytest.mark.parametrize("pfa", [1e-1, 1e-3, 1e-9, 1e-12])
def test_osca_factor_of_one_column_of_one_cell_is_the_ca_factor(pfa, looks):
    assert osca_factor(pfa, ((1, 1),), looks) == pytest.approx(ca_factor(pfa, 1, looks), rel=1e-9)


@pytest.mark.parametrize(
    ("columns", "looks", "pfa"),
    [
        *((((6, 9),), looks, pfa) for looks, pfa in ((2, 1e-9), (16, 1e-1), (256, 1e-3))),
        *((((3, 5), (2, 4)), 4, 1e-4), (((1, 1),) * 9, 6, 1e-3)),
        *((OUTSIDE, 2, 1e-6), (INSIDE, 16, 1e-15), (INSIDE, 16, 0.49)),
    ],
)
def test_osca_factor_of_one_or_several_columns_gives_the_convolved_rate(columns, looks, pfa):
    rate = convolved_rate(osca_factor(pfa, columns, looks), columns, looks)
    assert rate == pytest.approx(pfa, rel=1e-7)


goca_rate = partial(chosen_half_rate, greatest=True)
soca_rate = partial(chosen_half_rate, greatest=False)


@few
@given(PFAS, st.sampled_from([1, 3, 16]))
def test_rates_undo_factors(pfa, looks):
    assert ca_rate(ca_factor(pfa, 72, looks), 72, looks) == pytest.approx(pfa, rel=1e-9)
    assert osca_rate(osca_factor(pfa, INSIDE, looks), INSIDE, looks) == pytest.approx(pfa, rel=1e-9)
    for halves in ((36, 36), (3, 72), (1, 9)):
        assert goca_rate(goca_factor(pfa, halves, looks), halves, looks) == pytest.approx(pfa, rel=1e-9)
        assert soca_rate(soca_factor(pfa, halves, looks), halves, looks) == pytest.approx(pfa, rel=1e-9)


HALVES = st.tuples(st.integers(1, 60), st.integers(1, 60))


@few
@given(PFAS, HALVES, st.sampled_from([1, 2, 16, 256]))
def test_rates_of_the_greatest_and_the_smallest_half_add_to_those_of_both_halves(pfa, halves, looks):
    for factor in (goca_factor(pfa, halves, looks), soca_factor(pfa, halves, looks)):
        together = goca_rate(factor, halves, looks) + soca_rate(factor, halves, looks)
        assert together == pytest.approx(sum(ca_rate(factor, n, looks) for n in halves), rel=1e-9)


@pytest.mark.parametrize("n", [1, 5, 36])
@pytest.mark.parametrize("pfa", [0.1, 1e-3, 1e-9])
def test_soca_factor_of_one_look_gives_the_rate_of_the_published_sum(n, pfa):
    t = soca_factor(pfa, (n, n)) / n
    published = 2 * sum(math.comb(n - 1 + k, k) * (2 + t) ** -(n + k) for k in range(n))
    assert published == pytest.approx(pfa, rel=1e-10)


@pytest.mark.parametrize("halves", [(36, 36), (3, 72), (5, 1)])
@pytest.mark.parametrize(("looks", "pfa"), [(1, 0.5), (2, 1e-30), (16, 1e-12), (256, 1e-3)])
def test_factors_of_the_chosen_half_give_the_integrated_rate(pfa, halves, looks):
    laws = [stats.gamma(looks * n, scale=1 / (looks * n)) for n in halves]
    ends = min(law.ppf(1e-60) for law in laws), max(law.isf(1e-60) for law in laws)
    log_mean = np.linspace(*np.log(ends), 8001)
    mean = np.exp(log_mean)
    for factor_of, other in ((goca_factor, stats.gamma.cdf), (soca_factor, stats.gamma.sf)):
        density = sum(
            own.pdf(mean) * other(mean, looks * n, scale=1 / (looks * n))
            for own, n in zip(laws, halves[::-1], strict=True)
        )
        factor = factor_of(pfa, halves, looks)
        exceeds = special.gammaincc(looks, looks * factor * mean)
        rate = np.sum(density * exceeds * mean) * (log_mean[1] - log_mean[0])
        assert rate == pytest.approx(pfa, rel=1e-8)


@pytest.mark.parametrize("looks", [1, 16])
def test_factor_of_one_empty_half_is_that_of_cell_averaging(looks):
    for factor_of, halves in product((goca_factor, soca_factor), ((0, 20), (20, 0))):
        assert factor_of(1e-3, halves, looks) == ca_factor(1e-3, 20, looks)


TRIMMED = st.integers(1, 80).flatmap(
    lambda n: st.integers(1, n).flatmap(
        lambda kept: st.tuples(st.just(n), st.integers(0, n - kept).map(lambda low: (low, n - kept - low)))
    )
)


@given(PFAS, TRIMMED)
def test_tm_factor_of_one_look_gives_the_rate_of_the_spacings(pfa, trim):
    n, (below, above) = trim
    kept = n - below - above
    t = tm_factor(pfa, n, (below, above)) / kept
    rate = 1.0
    for i in range(n - above):
        # The i-th spacing, of mean 1 / (n - i), lies under every kept cell above it.
        rate /= 1 + t * sum(1 for cell in range(below, n - above) if cell >= i) / (n - i)
    assert rate == pytest.approx(pfa, rel=1e-9)


@pytest.mark.parametrize(
    ("rank", "n", "pfa", "looks"),
    [
        (rank, n, pfa, (2, 16, 256)[(i + j) % 3])
        for i, (rank, n) in enumerate([(54, 72), (6, 9), (1, 72), (72, 72)])
        for j, pfa in enumerate([0.9, 1e-12, 1e-30])
    ],
)
def test_quadrature_for_the_mean_of_one_kept_cell_agrees_with_the_order_statistic(rank, n, pfa, looks):
    factor = osca_factor(pfa, ((rank, n),), looks)
    rate = many_looks_rate(factor, n, (rank - 1, n - rank), looks)
    assert rate == pytest.approx(pfa, rel=1e-2 if pfa == 1e-30 else 1e-4)


@pytest.mark.parametrize("looks", [2, 256])
def test_tm_factors_lie_between_those_that_trim_less_and_more(looks):
    factors = [tm_factor(1e-6, 72, (0, above), looks) for above in (0, 1, 18, 40, 71)]
    assert factors == sorted(factors)
    assert factors[0] == ca_factor(1e-6, 72, looks)
    assert factors[-1] == osca_factor(1e-6, ((1, 72),), looks)


def exact_tm_rate(factor, n, trimmed, looks):
    """Integrates the rate of sorted gamma powers of integer shape in rational numbers, cell by cell.

    The density of the first i cells, integrated up to x, is a sum of exp(-rate x) times polynomials in x and
    in z, the variable that counts arrivals of the cell under test in the kept ones.
    """
    t = factor / (n - sum(trimmed))
    law = {Fraction(0): {(0, 0): Fraction(1)}}
    for i in range(n):
        kept = trimmed[0] <= i < n - trimmed[1]
        arrivals = [t**m / math.factorial(m) for m in range(looks)] if kept else [Fraction(1)]
        constant, integrated = {}, {}
        for rate, polynomial in law.items():
            total = rate + 1 + (t if kept else 0)
            powers = {}
            for (z, x), c in polynomial.items():
                for m, a in enumerate(arrivals[: looks - z]):
                    powers.setdefault(z + m, {}).setdefault(x + m + looks - 1, []).append(a * c)
            terms = integrated.setdefault(total, {})
            for z, by_power in powers.items():
                tail = Fraction(0)
                for q in range(max(by_power), -1, -1):
                    tail = (sum(by_power.get(q, ()), start=Fraction(0)) + tail * (q + 1)) / total
                    terms[z, q] = terms.get((z, q), 0) - tail
                constant[z, 0] = constant.get((z, 0), 0) + tail
        law = {**integrated, Fraction(0): constant}
        scale = Fraction(1, math.factorial(looks - 1))
        law = {rate: {key: c * scale for key, c in terms.items()} for rate, terms in law.items()}
    return float(math.factorial(n) * sum(law[Fraction(0)].values()))


# One look has a closed form that a test above holds to 1e-9.
@pytest.mark.parametrize(
    ("n", "trimmed", "pfa", "looks"),
    [
        *((2, (0, 1), 1e-15, 3), (4, (1, 1), 0.5, 3), (6, (0, 2), 1e-15, 2)),
        *((6, (2, 0), 1e-3, 2), (8, (2, 2), 1e-3, 2)),
    ],
)
def test_tm_factor_gives_the_rate_of_rational_numbers(n, trimmed, pfa, looks):
    factor = float(f"{tm_factor(pfa, n, trimmed, looks):.5g}")
    exact = exact_tm_rate(Fraction(factor), n, trimmed, looks)
    assert exact == pytest.approx(pfa, rel=2e-3)
    assert many_looks_rate(factor, n, trimmed, looks) == pytest.approx(exact, rel=1e-6)


@pytest.mark.parametrize(
    ("n", "trimmed", "pfa", "looks"),
    [(72, (36, 1), 0.5, 2), (300, (1, 1), 1e-15, 2), (72, (18, 18), 1e-6, 16)],
)
def test_tm_factor_does_not_depend_on_the_nodes(monkeypatch, n, trimmed, pfa, looks):
    factor = tm_factor(pfa, n, trimmed, looks)
    for name, value in {"_N_PLANE": 96, "_N_BETWEEN": 28, "_NEGLIGIBLE": -27.0}.items():
        monkeypatch.setattr(trimmed_factors, name, value)
    assert many_looks_rate(factor, n, trimmed, looks) == pytest.approx(pfa, rel=1e-6)


@pytest.mark.parametrize(("n", "trimmed"), [(8, (1, 4)), (72, (0, 70))])
def test_tm_factor_of_a_rate_of_1e_minus_30_is_found_where_the_kept_law_is_below_any_float64(n, trimmed):
    factor = tm_factor(1e-30, n, trimmed, 2)
    assert many_looks_rate(factor, n, trimmed, 2) == pytest.approx(1e-30, rel=1e-6)


def test_a_factor_of_nothing_alarms_always():
    assert ca_rate(0.0, 8) == goca_rate(0.0, (4, 4), 1) == soca_rate(0.0, (4, 4), 1) == 1


def test_order_of_the_columns_does_not_change_the_factor():
    assert osca_factor(1e-3, INSIDE, 4) == pytest.approx(osca_factor(1e-3, INSIDE[::-1], 4), rel=1e-13)


@pytest.mark.parametrize("pfa", [1e-30, 0.999999])
@pytest.mark.parametrize("columns", [INSIDE, ((1, 1),), ((1, 90),) * 9, ((90, 90),), ((500, 700),) * 33])
def test_osca_factor_holds_the_rate_at_the_ends_of_its_range(pfa, columns):
    rate = one_look_rate(osca_factor(pfa, columns), columns)
    assert min(rate, 1 - rate) == pytest.approx(min(pfa, 1 - pfa), rel=1e-7)


BEYOND = r"from 1e-30 to 0\.999999"
REFUSED = [
    ("pfa =", [ca_factor, paper_factor], product((0, 1, -0.1, 1.5, math.nan, "0.1"), [8])),
    ("pfa =", [osca_factor], product((0, 1, -0.1, 1.5, math.nan, "0.1"), [INSIDE])),
    ("looks =", [ca_factor], product([0.1], [8], (0, -1, 2.5, math.nan, "2"))),
    ("looks =", [osca_factor], product([0.1], [INSIDE], (0, -1, 2.5, math.nan, "2"))),
    ("n_training =", [ca_factor, ca_rate, paper_factor], [(0.1, 0)]),
    ("columns =", [osca_factor], product([1e-3], ((), ((0, 9),), ((10, 9),), ((6, 9), (1, 0))))),
    ("halves =", [goca_factor, soca_factor], product([1e-3], ((0, 0), (-1, 3), (1,)))),
    ("trimmed =", [tm_factor], product([1e-3], [8], ((4, 4), (-1, 2), (1,), (0.5, 1)), [2])),
    (BEYOND, [goca_factor, soca_factor], product((1e-31, 1 - 1e-7), [(4, 4)], (1, 16))),
    (BEYOND, [tm_factor], product((1e-31, 1 - 1e-7), [8], [(2, 2)], (1, 16))),
    (BEYOND, [osca_factor], product((1e-31, 1 - 1e-7), [INSIDE], (1, 16))),
    (r"pfa = 1e-320: the factor overflows", [ca_factor, paper_factor], [(1e-320, 1)]),
]


@pytest.mark.parametrize(
    ("message", "function", "arguments"),
    [(message, *call) for message, functions, arguments in REFUSED for call in product(functions, arguments)],
)
def test_what_has_no_factor_is_refused_by_name(message, function, arguments):
    with pytest.raises(InputError, match=message):
        function(*arguments)
