"""Clean echo behind weights on the resource grid: range-Doppler cells of the gate, without the full cube.

Echoes of one speed share a Doppler profile, and weights a[n, m] then act on
every subcarrier by one number a Doppler bin and speed:

    A_v[n, d] = Σ_m F[d, m] exp(j2π m T f_v) a[n, m].

What remains is a sum over speeds and a transform over subcarriers. Directions
of a region span few of the dimensions that an array has: sums are taken over
these, and only the cells of the gate are spread over the elements.
"""

from __future__ import annotations

import numpy as np

from isacbench.checked_arrays import Complex, Floats
from isacbench.dsp.partial_dft import doppler_rows, range_bins_by_fft
from isacbench.model.echo import EchoParameters, echo_responses, is_dust
from isacbench.model.gate import Gate
from isacbench.model.scene import Scenario

MOST_NUMBERS = 2**23
"""Complex numbers of an intermediate array that are held at a time: 128 MB."""

ROUNDINGS = 32.0
"""Roundings of the largest singular value below which a dimension of the directions is rounding."""


def weighted_echo(scenario: Scenario, gate: Gate, weight: Floats) -> Complex:
    """Compute the noise-free range-Doppler cells of the gate behind weights on the resource grid.

    Parameters
    ----------
    weight : ndarray of float64, shape (n_subcarriers, n_symbols)
        Factor of the echo on each resource element, 0 or more.

    Returns
    -------
    ndarray of complex128, shape (n_range, n_doppler, P, Q)
    """
    system = scenario.system
    echo, responses = echo_responses(scenario, scenario.array.positions)
    coordinates, basis = _dimensions(responses)
    at_dimensions = _cells(echo, gate, weight, coordinates)
    # Explicit sizes, because -1 cannot be resolved where a scene is empty.
    n_cells, (n_dimensions, n_elements) = gate.shape[0] * gate.shape[1], basis.shape
    cells: Complex = at_dimensions.reshape(n_cells, n_dimensions) @ basis
    cells = cells.reshape(*gate.shape, n_elements)
    if is_dust(cells, echo, float(weight.sum()) / np.sqrt(system.processing_gain)):
        cells[:] = 0
    return cells.reshape(*gate.shape, *scenario.array.shape)


def _dimensions(responses: Complex) -> tuple[Complex, Complex]:
    """Coordinates (K, k) of responses (K, e) in an orthonormal basis (k, e) of what they span."""
    left, singular, basis = np.linalg.svd(responses, full_matrices=False)
    rank = int((singular > ROUNDINGS * np.finfo(np.float64).eps * singular.max(initial=0)).sum())
    return left[:, :rank] * singular[:rank], basis[:rank]


def _cells(echo: EchoParameters, gate: Gate, weight: Floats, coordinates: Complex) -> Complex:
    """Cells (n_range, n_doppler, k) of echoes whose responses have k coordinates."""
    (n_range, n_doppler), n_subcarriers, n_dimensions = gate.shape, len(weight), coordinates.shape[1]
    cells = np.empty((n_range, n_doppler, n_dimensions), dtype=np.complex128)
    # Whole lines of subcarriers are held, of as many dimensions as memory allows.
    n_together = max(MOST_NUMBERS // (n_subcarriers * n_doppler), 1)
    for first in range(0, n_dimensions, n_together):
        some = slice(first, first + n_together)
        lines = _doppler_lines(echo, gate, weight, coordinates[:, some])
        cells[:, :, some] = range_bins_by_fft(lines, gate.range_bins)
    return cells


def _doppler_lines(echo: EchoParameters, gate: Gate, weight: Floats, coordinates: Complex) -> Complex:
    """Doppler bins (n_subcarriers, n_doppler, k) of all subcarriers, a few of them at a time."""
    n_subcarriers, n_symbols = weight.shape
    speeds, of_speed = np.unique(echo.doppler_bin, return_inverse=True)
    symbols = np.arange(n_symbols)
    profiles = np.exp(2j * np.pi * np.outer(speeds, symbols) / n_symbols)
    rows = doppler_rows(gate.doppler_bins, n_symbols)
    # The weights are real: half the operations.
    columns = (rows[:, None] * profiles).reshape(-1, n_symbols).T.copy().view(np.float64)
    amplitudes = echo.gain[:, None] * coordinates
    echoes_of = [np.flatnonzero(of_speed == k) for k in range(speeds.size)]
    lines = np.empty((n_subcarriers, len(rows), coordinates.shape[1]), dtype=np.complex128)
    largest = max(speeds.size * max(coordinates.shape[1], len(rows)), len(echo.gain), 1)
    n_together = max(MOST_NUMBERS // largest, 1)
    for first in range(0, n_subcarriers, n_together):
        part = slice(first, min(first + n_together, n_subcarriers))
        subcarriers = np.arange(part.start, part.stop)
        profile = (weight[part] @ columns).view(np.complex128).reshape(-1, len(rows), speeds.size)
        at_speed = np.empty((subcarriers.size, speeds.size, coordinates.shape[1]), dtype=np.complex128)
        for k, echoes in enumerate(echoes_of):
            delays = np.exp(-2j * np.pi / n_subcarriers * np.outer(subcarriers, echo.range_bin[echoes]))
            at_speed[:, k] = delays @ amplitudes[echoes]
        lines[part] = profile @ at_speed
    return lines
