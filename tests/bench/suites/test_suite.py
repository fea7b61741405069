import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.bench.cells.task import build_estimators
from isacbench.bench.kinds.detection import DetectionSuite
from isacbench.bench.kinds.resolution import ResolutionSuite
from isacbench.bench.suites.suite import parse_snr, suite_names
from isacbench.bench.suites.suite_kinds import kind_of, load_suite, restore_suite
from isacbench.errors import InputError

MINIMAL = """
name = "mine"
scenarios = ["street", "own/scene.toml"]
estimators = ["music2d[pfa=1e-4]"]
snr_db = [0]
trials = 1
"""


@pytest.fixture
def suite_file(tmp_path):
    def write(text):
        path = tmp_path / "mine.toml"
        path.write_text(text)
        return path

    return write


def test_the_paper_suite_is_both_estimators_and_the_oracle_on_both_frames_over_the_grid():
    suite = load_suite("paper")
    assert suite.estimators == ("fft4d", "music2d", "oracle")
    assert suite.scenarios == ("street", "street-paper")
    assert suite.snr_db == (-55, -50, -45, -40, -35, -30, -20, -10, -5, 10)
    assert (suite.trials, suite.seed) == (10, 0)


def test_every_built_in_suite_loads_under_its_own_name():
    assert {"paper", "quick"} <= set(suite_names())
    assert all(load_suite(name).name == name for name in suite_names())


@pytest.mark.parametrize("name", suite_names())
def test_no_built_in_suite_has_an_estimator_twice(name):
    assert build_estimators(load_suite(name))


def test_scenario_paths_are_relative_to_the_suite_file(suite_file):
    path = suite_file(MINIMAL)
    assert load_suite(path).scenarios == ("street", str(path.parent / "own" / "scene.toml"))


STUDY = MINIMAL.replace("snr_db = [0]", "snr_gain_db = {start = 0, stop = 45, step = 5}")
RESOLUTION = f'kind = "resolution"\nseparations_cells = [0.25, 1]\n{STUDY}'
DETECTION = f'kind = "detection"\ndetectors = ["ca"]\n{STUDY}'


def test_a_kind_brings_keys_of_its_own_and_imaging_is_the_default(suite_file):
    assert load_suite(suite_file(MINIMAL)).kind == "imaging"
    assert load_suite(suite_file(f'kind = "efficiency"\n{STUDY}')).snr_gain_db == tuple(range(0, 50, 5))
    resolution = load_suite(suite_file(RESOLUTION))
    assert isinstance(resolution, ResolutionSuite)
    assert (resolution.dimensions, resolution.phases_deg) == (("range", "velocity", "u", "w"), (0.0,))
    detection = load_suite(suite_file(DETECTION))
    assert isinstance(detection, DetectionSuite)
    assert (len(detection.maps), detection.pfa) == (4, ())


@pytest.mark.parametrize(
    ("text", "old", "new", "message"),
    [
        (MINIMAL, "trials = 1", "trials = 0", "trials = 0: input should be greater than or equal to 1"),
        (MINIMAL, "trials = 1", "trials = 1\ntrails = 1", "unknown key trails: did you mean 'trials'"),
        (MINIMAL, "trials = 1", "", "missing key trials"),
        (MINIMAL, "[0]", "[]", "snr_db"),
        (MINIMAL, "[0]", "[0, 5, 0]", "0.0 is listed twice"),
        (MINIMAL, "[0]", "[nan]", "snr_db[0] = nan"),
        (MINIMAL, "[0]", "[1e6]", "snr_db[0] = 1000000.0: input should be less than or equal to 300"),
        (MINIMAL, "[0]", "{start = 0, stop = 1}", "a table takes three numbers, start, stop and step"),
        (MINIMAL, "[0]", "{start = 0, stop = 1, step = 0}", "step positive"),
        (MINIMAL, '"mine"', '"a/b"', "name = 'a/b'"),
        (MINIMAL, "trials = 1", "trials = 1\ntrials = 2", "not valid TOML"),
        (
            RESOLUTION,
            '"resolution"',
            '"imagine"',
            "kind = 'imagine': allowed are 'imaging', 'efficiency',",
        ),
        (RESOLUTION, '"resolution"', '"efficiency"', "unknown key separations_cells: allowed are kind, name"),
        (RESOLUTION, "separations_cells", "separations", "did you mean 'separations_cells'"),
        (RESOLUTION, "0.25", "0", "separations_cells[0] = 0: input should be greater than 0"),
        (RESOLUTION, "[0.25, 1]", "[1, 1]", "1.0 is listed twice"),
        (RESOLUTION, "trials", 'dimensions = ["x"]\ntrials', "dimensions[0] = 'x': input should be 'range'"),
        (DETECTION, 'detectors = ["ca"]', "", "missing key detectors"),
        (DETECTION, "trials", "pfa = [2]\ntrials", "pfa[0] = 2: input should be less than 1"),
        (DETECTION, "trials", 'maps = ["flat"]\ntrials', "maps[0] = 'flat': input should be 'homogeneous'"),
        (MINIMAL, "snr_db = [0]", "", "missing key snr_db"),
        (MINIMAL, "trials", "snr_gain_db = [0]\ntrials", "give either snr_db, per element, or snr_gain_db"),
        (STUDY, "stop = 45", "stop = 'a'", "snr_gain_db = {"),
    ],
)
def test_a_mistake_in_a_suite_names_the_file_the_key_and_what_is_allowed(suite_file, text, old, new, message):
    path = suite_file(text.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        load_suite(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("text", [MINIMAL, RESOLUTION, DETECTION])
def test_a_suite_is_restored_from_what_it_dumps(suite_file, text):
    suite = load_suite(suite_file(text))
    assert restore_suite(suite.model_dump()) == suite
    assert type(restore_suite(suite.model_dump())) is type(suite)


def test_a_suite_of_the_first_version_is_restored_as_imaging():
    old = load_suite("quick").model_dump(exclude={"kind", "snr_gain_db"})
    assert restore_suite(old) == load_suite("quick")


def test_a_class_refuses_the_kind_of_another(suite_file):
    suite = load_suite(suite_file(MINIMAL))
    assert kind_of(suite.replace(kind="efficiency")).name == "efficiency"
    for kind in ("resolution", "imagine"):
        with pytest.raises(InputError, match=f"kind = '{kind}' with Suite: allowed are 'imaging' with Suite"):
            kind_of(suite.replace(kind=kind))


def test_new_snrs_of_one_sort_take_the_place_of_the_other(suite_file):
    suite = load_suite(suite_file(STUDY))
    by_element = suite.replace(snr_db=[1.0])
    assert (by_element.snr_db, by_element.snr_gain_db) == ((1.0,), None)
    assert by_element.replace(snr_gain_db=[2.0]).snr_db is None
    assert suite.replace(trials=3).snr_gain_db == suite.snr_gain_db


def test_an_unknown_suite_is_answered_with_the_nearest_one():
    with pytest.raises(InputError, match="did you mean 'quick'"):
        load_suite("quik")


def test_replacing_keeps_what_is_not_given_and_checks_what_is():
    suite = load_suite("quick").replace(trials=7, seed=None)
    assert (suite.trials, suite.seed, suite.snr_db) == (7, 0, load_suite("quick").snr_db)
    with pytest.raises(InputError, match="trials = 0"):
        suite.replace(trials=0)
    with pytest.raises(InputError, match=r"estimators .*listed twice"):
        suite.replace(estimators=["a", "a"])


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("-30:20:5", tuple(range(-30, 21, 5))),
        ("-1:1:0.1", tuple(n / 10 for n in range(-10, 11))),
        ("0:1:0.3", (0, 0.3, 0.6, 0.9)),
        ("5:5:1", (5,)),
        ("-5", (-5,)),
        ("-5,0,2.5", (-5, 0, 2.5)),
    ],
)
def test_snr_ranges_include_both_ends(text, values):
    assert parse_snr(text) == values


@given(
    start=st.integers(-200, 100),
    n_steps=st.integers(0, 50),
    step=st.sampled_from([0.1, 0.25, 0.3, 1, 2.5, 5]),
)
def test_the_end_of_a_grid_survives_rounding(start, n_steps, step):
    stop = round(start + n_steps * step, 6)
    if stop <= 300:
        values = parse_snr(f"{start}:{stop}:{step}")
        assert len(values) == n_steps + 1
        assert values[-1] == stop


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a", "allowed are start:stop:step"),
        ("1:2", "allowed are start:stop:step"),
        ("1,,2", "allowed are start:stop:step"),
        ("1_0", "allowed are start:stop:step"),
        ("１０", "allowed are start:stop:step"),
        ("nan", "from -300 to 300"),
        ("0:inf:1", "from -300 to 300"),
        ("0:5:-1", "step positive"),
        ("5:0:1", "stop no less than start"),
        ("0:5:1e-6", "allowed are at most 1000"),
    ],
)
def test_a_bad_snr_is_quoted_with_what_is_allowed(text, message):
    with pytest.raises(InputError) as caught:
        parse_snr(text)
    assert message in str(caught.value)
    assert repr(text) in str(caught.value)
