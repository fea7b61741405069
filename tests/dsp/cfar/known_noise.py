"""Noise that the built-in detectors estimate, cell by cell: slow, and plainly right."""

import math
from fractions import Fraction
from functools import partial
from itertools import product

from isacbench.dsp.cfar.factors import ca_factor, goca_factor, osca_factor, soca_factor
from isacbench.dsp.cfar.trimmed_factors import tm_factor

ROUNDING = 1e-9
"""What rounding may take from the product of a fraction and a number of cells."""


def known_noise(detector, power, cell, looks=1, number=float):
    """Estimates the noise around a cell, in floats with exact sums or in rational numbers.

    Returns it with the factor of its law: how many cells there are, and which ranks.
    """

    def sorted_at(places):
        return sorted(number(float(power[place])) for place in places)

    places = training_cells(detector, power.shape, cell)
    values, n = sorted_at(places), len(places)
    match detector.name:
        case "ca":
            return mean(values), partial(ca_factor, detector.pfa, n, looks)
        case "os":
            rank = max(1, share(detector.rank_fraction, n))
            return values[rank - 1], partial(osca_factor, detector.pfa, ((rank, n),), looks)
        case "tm":
            below, above = share(detector.trim_low, n), share(detector.trim_high, n)
            kept = values[below : n - above]
            return mean(kept), partial(tm_factor, detector.pfa, n, (below, above), looks)
        case "osca":
            columns = columns_of(detector, places)
            noise = mean([sorted_at(one)[column_rank(len(one)) - 1] for one in columns])
            ranks = tuple((column_rank(len(one)), len(one) - (cell in one)) for one in columns)
            return noise, partial(osca_factor, detector.pfa, ranks, looks)
        case _:
            factor_of, chosen = (goca_factor, max) if detector.name == "goca" else (soca_factor, min)
            halves = halves_of(detector, places, cell)
            noise = chosen(mean(sorted_at(half)) for half in halves if half)
            return noise, partial(factor_of, detector.pfa, tuple(map(len, halves)), looks)


def training_cells(detector, shape, cell):
    """Lists the training cells; the window shifts to stay inside the map, its guard cells do not."""
    training = per_axis(detector.training, len(shape))
    guard = per_axis(0 if detector.guard is None else detector.guard, len(shape))
    reach = [t + g for t, g in zip(training, guard, strict=True)]
    axes = zip(cell, reach, shape, strict=True)
    starts = [min(max(place - r, 0), length - 2 * r - 1) for place, r, length in axes]
    window = product(*(range(start, start + 2 * r + 1) for start, r in zip(starts, reach, strict=True)))
    if detector.guard is None:
        return list(window)
    guarded = set(product(*(range(c - g, c + g + 1) for c, g in zip(cell, guard, strict=True))))
    return [place for place in window if place not in guarded]


def columns_of(detector, places):
    """Sorts training cells into columns along the axis of the order statistic."""
    columns = {}
    for place in places:
        columns.setdefault(without(place, detector.order_axis), []).append(place)
    return list(columns.values())


def halves_of(detector, places, cell):
    """Sorts training cells into those that lead the cell under test and those that trail it."""

    def order(place):
        return (place[detector.split_axis], *without(place, detector.split_axis))

    halves = [], []
    for place in places:
        halves[order(place) > order(cell)].append(place)
    return halves


def column_rank(n_cells):
    """Rank of the order statistic of a column; 1 is the smallest."""
    return max(1, 3 * n_cells // 4)


def share(fraction, n_cells):
    """Rounds a share of the training cells down."""
    return math.floor(fraction * n_cells + ROUNDING)


def per_axis(sizes, n_axes):
    return sizes if isinstance(sizes, tuple) else (sizes,) * n_axes


def without(place, axis):
    return (*place[:axis], *place[axis + 1 :])


def mean(values):
    total = sum(values) if isinstance(values[0], Fraction) else math.fsum(values)
    return total / len(values)
