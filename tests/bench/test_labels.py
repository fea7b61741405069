"""Labels of estimators: what a reader takes for the default is the default."""

import pandas as pd
import pytest

from isacbench.bench.labels import estimator_labels, references_in
from isacbench.plugins.registry import build_estimator, build_variants, canonical_params


def labels(*specs):
    plugins = [plugin for spec in specs for _, plugin in build_variants("estimator", spec)]
    variants = [("music2d", canonical_params(plugin)) for plugin in plugins]
    return list(estimator_labels(variants).values())


@pytest.mark.parametrize(
    "spec",
    [
        "music2d",
        "music2d[pfa=0.0001]",
        "music2d[integration=element,detector=ca]",
        "music2d[detector=osca]",
        "music2d[detector=osca[pfa=0.01,order_axis=1]]",
        "music2d[spectrum_detector=ca[pfa=0.3]]",
    ],
)
def test_a_label_is_a_specification_that_means_the_same(spec):
    (label,) = labels(spec)
    assert canonical_params(build_estimator(label)) == canonical_params(build_estimator(spec))
    assert (label == "music2d") == (spec == "music2d")


@pytest.mark.parametrize(
    "specs",
    [
        ("music2d", "music2d[detector=osca]"),
        ("music2d", "music2d[detector=osca]", "music2d[pfa=0.01]"),
        ("music2d", "music2d[grid_points=75]", "music2d[grid_points=101]"),
        ("music2d", "music2d[pfa=0.01]", "music2d[grid_points=101]"),
        ("music2d[search=root]", "music2d"),
    ],
)
def test_the_default_has_the_bare_name_and_is_left_out_whatever_the_other_variants_are(specs):
    assert labels(*specs) == [*specs]


def test_what_is_not_registered_is_told_apart_from_its_namesakes():
    variants = [
        ("nowhere", f'{{"d":{{"n":{n},"name":"inner"}},"k":{k}}}') for n, k in ((1, 1), (1, 2), (2, 1))
    ]
    assert list(estimator_labels(variants).values()) == [
        "nowhere[d=inner[n=1],k=1]",
        "nowhere[d=inner[n=1],k=2]",
        "nowhere[d=inner[n=2],k=1]",
    ]
    assert estimator_labels(variants[:1]) == {variants[0]: "nowhere"}


def test_values_are_spelled_as_a_suite_spells_them():
    params = ['{"pfa":null}', '{"pfa":0.5}', '{"guard":[0,3],"on":true}', '{"guard":[1],"on":false}']
    variants = [*(("c", one) for one in params[:2]), *(("d", one) for one in params[2:])]
    labels = ["c[pfa=none]", "c[pfa=0.5]", "d[guard=(0,3),on=true]", "d[guard=(1),on=false]"]
    assert list(estimator_labels(variants).values()) == labels


def test_references_are_found_by_name_and_what_is_not_installed_is_none(plugins):
    assert references_in(pd.DataFrame({"estimator": ["seer", "blob", "gone"]})) == {"seer"}
