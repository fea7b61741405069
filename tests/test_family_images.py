"""Images of small scenes of all families, frames and phases are those that are committed."""

import pytest

from tests.conftest import slow_but
from tests.family_images import SCENES, committed_rows, rows_of

# Each family in both frames and with both phases, but not in all four combinations.
QUICK = [name for number, name in enumerate(SCENES) if (number % 4 in (1, 2)) == (number // 4 % 2 == 0)]


@pytest.mark.parametrize("name", slow_but(QUICK, SCENES))
def test_images_of_a_family_are_the_committed_ones(name):
    committed = committed_rows()
    for key, scores in rows_of(name):
        assert scores == pytest.approx(committed[key], rel=1e-5, abs=1e-6), key
