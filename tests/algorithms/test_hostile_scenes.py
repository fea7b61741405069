"""Scenes at the limits of the radio, of which every estimator keeps the promises: one table for all."""

from functools import cache

import numpy as np
import pytest
from isacbench_algorithms.fft4d import Fft4d

from isacbench.checking.image_checks import ANY_SCALE, ELEMENT_ORDER, FOUND_FIRST, INVARIANT, LAYOUT
from isacbench.checking.scenes import Echo, Layout, observed
from isacbench.checking.stress import BROKEN, run_case
from isacbench.model.numerology import System
from isacbench.model.region import Region
from isacbench.plugins.registry import build_estimator
from tests.algorithms.scenes import stress_case
from tests.checking.narrowed import narrowed
from tests.conftest import slow_but

NAMES = [
    *("fft4d", "fft4d[integration=element]", "music2d", "music2d[search=root]", "music2d_joint", "esprit2d"),
    *("bartlett2d", "capon2d", "iaa2d", "nomp4d", "omp4d", "sbl4d"),
]
NO_RANGE = "numerology[n_subcarriers=1,n_symbols=32,noise={}]"
HOSTILE = [
    *(f"array[n_u={n_u},n_w={n_w}]" for n_u, n_w in ((2, 2), (2, 3), (3, 5), (4, 4), (2, 32), (32, 2))),
    *("bin[doppler_offset=0.99,where=whole_map]", "bin[doppler_offset=-0.5,where=whole_map]"),
    "bin[range_offset=1.0,doppler_offset=1.0,where=last_bins]",
    *(NO_RANGE.format("20dB"), "numerology[n_subcarriers=97,n_symbols=13]"),
    *("pair[half_turns=1.0]", "direction[radius=1.0,angle_deg=0.0]", "direction[radius=1.0,angle_deg=90.0]"),
    *("map[filled=zeros]", "map[filled=one_element,exponent=30]", "map[filled=loud_element,exponent=30]"),
    *("snr[snr_db=200]", "spread[n_echoes=4,draw=1]"),
]


def by_turns(cases, every=2):
    """Give every second or third estimator a case, and the others the next ones."""
    return [
        (name, case) for i, name in enumerate(NAMES) for j, case in enumerate(cases) if (i + j) % every == 0
    ]


SUBSPACES = ["music2d", "music2d_joint", "esprit2d", "capon2d"]
SHARES = [
    ("array[n_u=8,n_w=8]", 0.5),
    ("array[n_u=8,n_w=8]", 1.0),
    ("array[n_u=5,n_w=12]", 0.01),
    ("array[n_u=3,n_w=2]", 0.01),
    ("array[n_u=3,n_w=2]", 1.0),
]
WITH_PARAMETERS = [
    *((f"{name}[subarray_fraction={share}]", case) for name in SUBSPACES for case, share in SHARES),
    *(
        (f"{name}[detector=osca[training={training},order_axis=1]]", "snr[snr_db=20]")
        for name in ("fft4d", "music2d", "esprit2d", "iaa2d", "omp4d")
        for training in (1, 5, 12)
    ),
]


@pytest.mark.parametrize(
    ("estimator", "spec"), [*by_turns(HOSTILE, 3), *WITH_PARAMETERS, ("nomp4d", NO_RANGE.format("none"))]
)
def test_hostile_scenes_are_imaged_as_promised(estimator, spec):
    # Invariances have tests of their own, but for the pursuit where there is no range.
    invariant = spec == NO_RANGE.format("none")
    case = narrowed(stress_case(spec), lambda promise: invariant or promise not in INVARIANT)
    findings = run_case(case, build_estimator(estimator))
    assert [finding for finding in findings if finding.status in BROKEN] == []


ROUNDED = [
    *(("nomp4d", "beyond[what=gate,noise=none,excess=0.3]", promise) for promise in (FOUND_FIRST, LAYOUT)),
    ("nomp4d", "beyond[what=prefix,noise=none,excess=0.3]", ANY_SCALE),
    ("nomp4d", "beyond[what=gate,noise=none,excess=0.96]", ANY_SCALE),
    *(("nomp4d", f"close[exponent=-1.0,along={along}]", ANY_SCALE) for along in ("range", "doppler", "u")),
    ("sbl4d", "beyond[what=prefix,noise=none,excess=0.2]", ELEMENT_ORDER),
]
SLOW = [
    ("nomp4d", "coherent[n_echoes=3,separation=0.3]", ANY_SCALE),
    ("sbl4d", "beyond[what=prefix,noise=none,excess=0.7]", ELEMENT_ORDER),
]


@cache
def subject_of(name, spec):
    """Estimator and scene, whose image is made once."""
    return stress_case(spec).make(build_estimator(name))[0]


@pytest.mark.parametrize(("name", "spec", "promise"), slow_but(ROUNDED, [*ROUNDED, *SLOW]))
def test_images_that_hang_on_the_last_digits_keep_their_promise(name, spec, promise):
    subject = subject_of(name, spec)
    assert len(subject.cloud) >= (3 if name == "sbl4d" or "coherent" in spec else 1 + ("close" in spec))
    assert promise.measure(subject) <= promise.bound


WHOLE = System(n_subcarriers=16, n_symbols=64, cyclic_prefix_ratio=1.0, cyclic_suffix_ratio=0.0)
"""Whose range axis a region fills."""


@pytest.mark.parametrize(("name", "range_bin"), by_turns([0.02, 0.4, 15.3, 15.49]))
def test_a_scatterer_at_either_end_of_a_range_axis_without_margins_is_seen(name, range_bin):
    y_m = -0.985 * WHOLE.unambiguous_range_m, -0.01
    region = Region((-60.0, 60.0), y_m, (0.0, 14.0), (-30.0, 30.0))
    layout = Layout(WHOLE, (6, 6), region=region, base_station_m=(0.0, 0.0, 12.0))
    shot = observed([Echo(range_bin, 0.0, 0.05, 0.005)], 20.0, layout=layout)
    cloud = build_estimator(name).estimate(shot.observation)
    assert len(cloud) == 1
    assert np.linalg.norm(cloud.xyz - shot.scenario.truth.xyz) < 0.02 * WHOLE.range_bin_m
    assert abs(cloud.velocity[0]) < 0.5


@pytest.mark.parametrize("integration", ["noncoherent", "element"])
def test_exact_nulls_of_a_spectrum_are_drawn_without_a_warning(integration):
    # A scatterer straight ahead: the transform of equal numbers is zero at every multiple of 2/P.
    diagnosis = Fft4d(integration=integration).diagnose(observed([Echo(9.0, 0.0, 0.0, 0.0)]).observation)
    assert len(diagnosis.spectra) == 2
    for spectrum in diagnosis.spectra:
        assert np.isfinite(spectrum.level_db).all()
        assert spectrum.level_db.max() == 0
