import json

import pytest

from isacbench.bench.compare.pairs import find_variant, parse_map
from isacbench.bench.store.run import Run
from isacbench.errors import InputError
from isacbench.plugins.registry import build_estimator, canonical_params
from isacbench.specifications import spell_spec

CA = {"guard": [0, 3], "name": "ca", "pfa": 0.001}
STORED = [
    ("music2d", {"detector": CA, "pfa": 0.001, "points": 200, "fast": True, "order": None}),
    ("music2d", {"detector": CA, "pfa": 0.0001, "points": 200, "fast": True, "order": None}),
    (
        "music2d",
        {"detector": {"name": "osca", "pfa": 0.1}, "pfa": None, "points": 1, "fast": False, "order": 3},
    ),
    ("gone", {"mode": "osca", "size": 2.0}),
]


@pytest.fixture
def run(made_run):
    """Return a run of four variants, none of whose estimators needs to be installed."""
    names = [f"{number}" for number in range(len(STORED))]
    records, manifest = made_run(estimators=names, trials=1)
    number = records["estimator"].astype(int)
    records["estimator"] = [STORED[index][0] for index in number]
    records["params"] = [json.dumps(STORED[index][1], sort_keys=True) for index in number]
    return Run("results/mine", records, manifest)


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("music2d[pfa=1e-3]", 0),
        ("music2d[pfa=0.00010]", 1),
        ("music2d[detector=ca[pfa=1e-3],pfa=1e-4]", 1),
        ("music2d[detector=ca[guard=(0,3)],pfa=1e-3]", 0),
        ("music2d[detector=osca]", 2),
        ("music2d[pfa=none]", 2),
        ("music2d[points=1]", 2),
        ("music2d[fast=false]", 2),
        ("gone", 3),
        ("gone[size=2]", 3),
        *((spell_spec(*variant), number) for number, variant in enumerate(STORED)),
    ],
)
def test_a_variant_is_found_by_the_values_that_are_given_whatever_their_spelling(run, text, number):
    name, params = STORED[number]
    assert find_variant(run, text) == (name, json.dumps(params, sort_keys=True))


@pytest.mark.parametrize(
    "text",
    [
        "music2d[fast=1]",
        "music2d[points=true]",
        "music2d[order=0]",
        "music2d[detector=ca[guard=(0,3,3)]]",
        "music2d[detector=goca]",
        "gone[mode=osca[pfa=0.1]]",
    ],
)
def test_values_that_only_look_alike_do_not_fit(run, text):
    with pytest.raises(InputError, match=r"^results/mine: no variant fits '.*'; allowed are "):
        find_variant(run, text)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "music2d[pfa=1e-2]",
            "results/mine: no variant fits 'music2d[pfa=1e-2]'; allowed are music2d[detector=ca[guard=(0,3),"
            "pfa=0.001],fast=true,order=none,pfa=0.001,points=200], music2d[",
        ),
        (
            "music2d[detector=ca]",
            "'music2d[detector=ca]' fits 2 variants, music2d[detector=ca[guard=(0,3),pfa=0.001],"
            "pfa=0.001], music2d[detector=ca[guard=(0,3),pfa=0.001],pfa=0.0001]; give a specification",
        ),
        ("gome", "results/mine: no estimator fits 'gome': did you mean 'gone'? allowed are music2d, gone"),
        ("music2d[pfa=[1e-3,1e-4]]", "names 2 variants"),
    ],
)
def test_none_or_several_variants_are_refused_with_run_text_and_the_variants_that_there_are(
    run, text, message
):
    with pytest.raises(InputError) as caught:
        find_variant(run, text)
    assert message in str(caught.value)


def test_a_map_is_cut_at_its_own_equals_sign():
    assert parse_map("a[b=c[d=(1,2)]]=e[f=1]") == ("a[b=c[d=(1,2)]]", "e[f=1]")
    assert parse_map("a=b") == ("a", "b")
    with pytest.raises(InputError, match=r"map 'a\[b=c\]': allowed is OLD"):
        parse_map("a[b=c]")


def test_of_several_that_fit_the_one_with_that_label_is_meant(made_run):
    records, manifest = made_run(estimators=["0", "1"], trials=1)
    stored = [canonical_params(build_estimator(text)) for text in ("music2d", "music2d[search=root]")]
    records["params"] = [stored[int(name)] for name in records["estimator"]]
    run = Run("r", records.assign(estimator="music2d"), manifest)
    assert find_variant(run, "music2d") == ("music2d", stored[0])
    assert find_variant(run, "music2d[search=root]") == ("music2d", stored[1])
