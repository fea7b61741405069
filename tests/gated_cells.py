"""The gate of a scenario, and its cells cut out of the transform of a whole resource grid: an oracle."""

import numpy as np

from isacbench.dsp.rangedoppler import range_doppler_map
from isacbench.model.gate import build_gate


def gate_of(scenario):
    return build_gate(scenario.system, scenario.base_station_m, scenario.region)


def cells_in_gate(grid, gate):
    """Cells (range bins, Doppler bins, ...) of a gate from a resource grid (n, m, ...)."""
    bins = gate.range_bins % grid.shape[0], gate.doppler_bins % grid.shape[1]
    return range_doppler_map(grid)[np.ix_(*bins)]
