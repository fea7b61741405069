"""Words that suites, options and functions choose from, apart from the code that gives them a meaning.

A suite is held to them before NumPy is imported, so that a typing error is reported at once.
"""

from __future__ import annotations

from typing import Literal

Modulation = Literal["qpsk", "16qam", "64qam", "256qam"]
"""Of the data that are sent."""

Sensing = Literal["all", "prs"]
"""Resource elements that are sensed with: the whole grid, or the PRS alone."""

Division = Literal["reciprocal", "matched", "wiener"]
"""Division of the received by the transmitted symbols."""

NoiseSource = Literal["receiver", "transmitter"]
"""Where noise comes from: the receivers, or the transmitted signal itself."""

Mimo = Literal["ideal", "comb", "tdm"]
"""How transmitters are told apart: as if for nothing, by their subcarriers, or by their symbols."""

Dimension = Literal["range", "velocity", "u", "w"]
"""Dimensions in which the radio tells scatterers apart."""

MapName = Literal["homogeneous", "clutter-edge", "close-targets", "interferers"]
"""Synthetic power maps, see `isacbench.bench.kinds.power_maps.draw_power_map`."""
