"""Images of small scenes of all families, frames and phases are those that are committed."""

import pytest

from tests.conftest import slow_but
from tests.family_images import CASES, SCENES, SNRS_DB, committed_rows, rows_of

# Each family in both frames and with both phases, but not in all four combinations: in one at the highest
# SNR, and in the other at one of the others.
FEW = [name for number, name in enumerate(SCENES) if (number % 4 in (1, 2)) == (number // 4 % 2 == 0)]
QUICK = [(name, SNRS_DB[(0, 1, 2, 0)[n % 4]]) for n, name in enumerate(FEW)]


@pytest.mark.parametrize(("name", "snr_db"), slow_but(QUICK, CASES))
def test_images_of_a_family_are_the_committed_ones(name, snr_db):
    committed = committed_rows()
    for key, scores in rows_of(name, snr_db):
        assert scores == pytest.approx(committed[key], rel=1e-5, abs=1e-6), key
