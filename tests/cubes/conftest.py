"""A street with fewer resource elements and a smaller array, and its whole frame."""

import dataclasses

import numpy as np
import pytest

from isacbench.model.array import VirtualArray
from isacbench.model.echo import resource_grid
from isacbench.model.scenario import load_scenario


@pytest.fixture(scope="session")
def small_street():
    """Return the street on 512 x 56 resource elements and 8 x 6 virtual elements."""
    street = load_scenario("street")
    system = dataclasses.replace(street.system, n_subcarriers=512, n_symbols=56)
    return dataclasses.replace(street, system=system, array=VirtualArray((1, 1), (8, 6)))


@pytest.fixture(scope="session")
def clean_cube(small_street):
    """Return its frame without noise, complex128."""
    grid = resource_grid(small_street, small_street.array.positions)
    cube = grid.reshape(*grid.shape[:2], *small_street.array.shape)
    cube.setflags(write=False)
    return cube


@pytest.fixture(scope="session")
def noisy_cube(clean_cube):
    """Return its frame with noise of power 1, complex128."""
    parts = np.random.default_rng(7).standard_normal((*clean_cube.shape, 2)) * np.sqrt(0.5)
    cube = clean_cube + parts.view(np.complex128)[..., 0]
    cube.setflags(write=False)
    return cube
