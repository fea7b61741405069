import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.errors import InputError
from isacbench.specifications import MAX_VARIANTS, Spec, parse_spec, spec_variants


@pytest.mark.parametrize(
    ("text", "params"),
    [
        ("a", {}),
        ("a[]", {}),
        ("a[n=1,x=1e-4,y=-2.5,on=true,off=false]", {"n": 1, "x": 1e-4, "y": -2.5, "on": True, "off": False}),
        ("a[word=element, size=(4,4)]", {"word": "element", "size": (4, 4)}),
        ("a[n=1_0,m=１,x=1_0.5]", {"n": "1_0", "m": "１", "x": "1_0.5"}),
        ("a[d=b[pfa=1e-4,e=c[n=1]],m=2]", {"d": ("b", {"pfa": 1e-4, "e": ("c", {"n": 1})}), "m": 2}),
    ],
)
def test_specs_parse_into_names_and_typed_parameters(text, params):
    assert parse_spec(text) == ("a", params)
    assert all(
        type(parse_spec(text).params[key]) is type(value) for key, value in params.items() if key != "d"
    )


@pytest.mark.parametrize(
    "text",
    ["", "[", "a[", "a]", "a[n", "a[n=", "a[n=1", "a[n=1]]", "a[n=1 m=2]", "a[=1]", "a[n=(1,2]", "a b"],
)
def test_a_broken_spec_is_quoted_with_what_was_expected(text):
    with pytest.raises(InputError, match=r"expected .*allowed is NAME") as caught:
        parse_spec(text)
    assert repr(text) in str(caught.value)


def test_a_parameter_given_twice_is_refused():
    with pytest.raises(InputError, match="'n' is given twice"):
        parse_spec("a[n=1,n=2]")


@pytest.mark.parametrize(
    ("text", "texts"),
    [
        ("a", ["a"]),
        ("a[ n = 1 , m = (1, 2) ]", ["a[n=1,m=(1,2)]"]),
        ("a[n=[1]]", ["a[n=1]"]),
        ("a[n=[1,2],m=[x,y]]", ["a[n=1,m=x]", "a[n=1,m=y]", "a[n=2,m=x]", "a[n=2,m=y]"]),
        ("a[d=b[pfa=[1e-3,1e-4]]]", ["a[d=b[pfa=1e-3]]", "a[d=b[pfa=1e-4]]"]),
        ("a[d=[b,c[k=[1,2]]]]", ["a[d=b]", "a[d=c[k=1]]", "a[d=c[k=2]]"]),
        ("a[t=([1,2],3)]", ["a[t=(1,3)]", "a[t=(2,3)]"]),
        ("a[n=[1,1.0]]", ["a[n=1]", "a[n=1.0]"]),
    ],
)
def test_a_grid_is_the_product_of_its_alternatives_the_last_parameter_fastest(text, texts):
    assert [variant.text for variant in spec_variants(text)] == texts


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a[n=[]]", "expected an alternative for 'n' before ']'"),
        ("a[n=[1,2,1]]", "'n' lists the alternative 1 twice"),
        ("a[x=[0.001,1e-3]]", "'x' lists the alternative 1e-3 twice"),
        ("a[d=[b[n=[1,2]],b[n=2]]]", "'d' lists the alternative b[n=2] twice"),
        ("a[n=[[1,2],3]]", "expected a value before '[1,2],3]]'"),
        ("a[n=[1,2]", "expected ',' or ']' at its end"),
        ("a[n=[1 2]]", "expected ',' or ']' before '2]]'"),
        ("[a,b]", "expected a name before '[a,b]'"),
    ],
)
def test_a_broken_grid_is_quoted_with_what_is_wrong(text, message):
    with pytest.raises(InputError) as caught:
        spec_variants(text)
    assert message in str(caught.value)
    assert repr(text) in str(caught.value)


def test_a_grid_of_too_many_variants_is_refused_before_it_is_built():
    ten = "[0,1,2,3,4,5,6,7,8,9]"
    assert len(spec_variants(f"a[i={ten},j={ten},k={ten}]")) == MAX_VARIANTS
    with pytest.raises(InputError, match=f"{10**12} variants; allowed are at most {MAX_VARIANTS}"):
        spec_variants(f"a[{','.join(f'p{i}={ten}' for i in range(12))}]")
    many = ",".join(map(str, range(MAX_VARIANTS + 1)))
    with pytest.raises(InputError, match="at most"):
        spec_variants(f"a[n=[{many}]]")


def test_one_specification_is_asked_for_where_a_grid_stands_for_more():
    assert parse_spec("a[n=[1]]") == Spec("a", {"n": 1})
    with pytest.raises(InputError, match=r"names 2 variants \('a\[n=1\]', \.\.\.\)"):
        parse_spec("a[n=[1,2]]")


words = st.from_regex(r"[a-z_][a-z0-9_.-]{0,5}", fullmatch=True)
scalars = st.one_of(
    st.booleans().map(lambda value: str(value).lower()),
    st.integers().map(str),
    st.floats(allow_nan=False).map(str),
    words,
)


def nested(values):
    """Specifications, tuples and lists of alternatives, each with the number of variants it stands for."""
    lists = st.lists(values, min_size=1, max_size=3)
    items = st.dictionaries(words, values, min_size=1, max_size=3)
    spec = st.tuples(words, items).map(
        lambda spec: (
            f"{spec[0]}[{','.join(f'{key}={text}' for key, (text, _) in spec[1].items())}]",
            math.prod(n for _, n in spec[1].values()),
        )
    )
    tuples = lists.map(lambda parts: (f"({','.join(t for t, _ in parts)})", math.prod(n for _, n in parts)))
    single = st.one_of(values.filter(lambda part: not part[0].startswith("[")), spec, tuples)
    choice = st.lists(single, min_size=1, max_size=3, unique_by=lambda part: part[0]).map(
        lambda parts: (f"[{','.join(text for text, _ in parts)}]", sum(n for _, n in parts))
    )
    return st.one_of(spec, tuples, choice)


grids = st.tuples(
    words,
    st.dictionaries(
        words, st.recursive(scalars.map(lambda text: (text, 1)), nested, max_leaves=6), max_size=3
    ),
)


@given(grids)
def test_every_variant_of_any_grid_is_one_specification_that_its_text_gives_back(grid):
    name, values = grid
    text = f"{name}[{','.join(f'{key}={value}' for key, (value, _) in values.items())}]"
    try:
        variants = spec_variants(text)
    except InputError as error:
        assert "twice" in str(error) or "at most" in str(error)  # noqa: PT017
        return
    assert len(variants) == math.prod(n for _, n in values.values())
    assert len({variant.text for variant in variants}) == len(variants)
    for variant in variants:
        assert repr(parse_spec(variant.text)) == repr(variant.spec)
        assert spec_variants(variant.text) == [variant]
