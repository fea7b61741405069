"""Echo of a scene through its waveform, without noise: an oracle of the closed form of echoes.

Scatterers are paths of the waveform. What arrives is demodulated and divided by the symbols that were sent.
"""

import numpy as np

from isacbench.link.reception.channel import Paths
from isacbench.link.sensing.division import Signal, division_factors, sensed_elements
from isacbench.link.waveform.ofdm import demodulate
from isacbench.link.waveform.resource_grid import draw_grid
from isacbench.model.echo import echo_parameters, element_responses
from isacbench.model.numerology import SPEED_OF_LIGHT_MPS
from tests.gated_cells import cells_in_gate, gate_of
from tests.link.sensing.propagation import propagate


def echo_paths(scenario, elements):
    """Paths from the base station via every scatterer to elements (E, 2); delays may exceed a symbol."""
    echo = echo_parameters(scenario)
    return Paths(
        gain=echo.gain[:, None] * element_responses(scenario, echo, np.asarray(elements)),
        delay_s=2 * scenario.range_m / SPEED_OF_LIGHT_MPS,
        doppler_hz=2 * scenario.scatterers.velocity * scenario.system.carrier_hz / SPEED_OF_LIGHT_MPS,
    )


def echo_symbols(scenario, grid, elements):
    """Demodulated symbols (n_subcarriers, n_symbols, E) of the echo at elements."""
    waveform = propagate(grid.symbols, scenario.system, echo_paths(scenario, elements))
    return demodulate(waveform, scenario.system)


def waveform_cells(
    scenario, *, modulation="qpsk", sensing="all", division="reciprocal", snr_db=np.inf, trial=0, seed=0
):
    """Cells of the gate, as of `isacbench.observe`; the SNR is that of Wiener's division."""
    grid = draw_grid(scenario.system, modulation, trial=trial, seed=seed)
    signal = Signal(modulation, sensing, division)
    sensed = sensed_elements(scenario.system, sensing)
    factors = division_factors(grid.symbols, sensed, signal.division, snr_db, unit=1.0)
    symbols = echo_symbols(scenario, grid, scenario.array.positions)
    cells = cells_in_gate(symbols * factors[:, :, None], gate_of(scenario))
    return cells.reshape(*cells.shape[:2], *scenario.array.shape)
