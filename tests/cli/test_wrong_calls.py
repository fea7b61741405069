"""Whatever a user mistakes ends in one line on standard error, exit code 2, and nothing written."""

from pathlib import Path

import pytest

CLOUD = "x,y,z,v,power\n1,2,3,0,1\n5,6,1,10,4\n"
STUDY = 'name = "s"\nscenarios = ["tiny.toml"]\nestimators = ["seer"]\nsnr_gain_db = [20]\ntrials = 2\n'
RESOLUTION = f'kind = "resolution"\nseparations_cells = [0.5]\ndimensions = ["u"]\n{STUDY}'


@pytest.fixture
def runs(made_run, written_run):
    """Write a run, the same once more, one whose nomp4d has other parameters, and one of three scenes."""
    records, manifest = made_run(estimators=("chance", "nomp4d"))
    for name in ("base", "same"):
        written_run(name, records, manifest)
    params = records["params"].where(records["estimator"] != "nomp4d", '{"pfa":0.0001}')
    written_run("new", records.assign(params=params), manifest)
    scenes = tuple(f"town[seed={seed}]" for seed in range(3))
    written_run("scenes", *made_run(scenarios=scenes, estimators=("fft4d", "music2d")))


@pytest.fixture
def refused(cli):
    """Return a function that holds a call to one line with all fragments, and to nothing written."""

    def contents():
        return {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()}

    def hold(words, *fragments):
        before = contents()
        result = cli(*words.split())
        assert (result.exit_code, result.stdout) == (2, ""), (words, result.output)
        assert result.stderr.startswith("isacbench: "), words
        assert result.stderr.count("\n") == 1, words
        assert not [fragment for fragment in fragments if fragment not in result.stderr], result.stderr
        assert contents() == before, words

    return hold


IMAGE, RUN = "image -s tiny.toml -e blob -o cloud.csv", "run quick -s tiny.toml -o out -e"
CALLS = [
    ("image -s streat", "unknown scenario 'streat'", "did you mean 'street'"),
    (f"{RUN} blop", "unknown estimator 'blop'", "did you mean 'blob'", "seer"),
    (f"{RUN} blob[m=1]", "unknown parameter of estimator blob 'm'", "n, pfa, mode"),
    (f"{RUN} blob[mode=x]", "mode = 'x'", "'near' or 'far'"),
    (f"{RUN} blob[n=1", "'blob[n=1'", "']'"),
    (f"{RUN} seer --snr 5:0:1", "'5:0:1'", "stop no less than start"),
    (f"{RUN} seer --snr warm", "'warm'", "start:stop:step"),
    (f"{RUN} seer --timing -j 2", "timing needs one job on this machine, not jobs 2"),
    (f"{RUN} seer --timing --dask tcp://nowhere:1", "timing needs one job on this machine, not dask"),
    (f"{RUN} seer --repeats 3", "repeats = 3 needs timing"),
    ("run quik", "unknown suite 'quik'", "did you mean 'quick'", "paper"),
    ("run gone.toml", "gone.toml", "no such file"),
    ("run efficiency -s tiny.toml -e seer", "scenario tiny", "too small", "0.5 in u"),
    ("run quick -s tiny.toml -e seer -o .", ".: exists", "new folder"),
    ("run population-quick --block 1 -s street", "--block 1", "-s street"),
    ("run --plugin gone.py", "gone.py: does not exist"),
    ("list --plugin gone.py", "gone.py: does not exist"),
    (f"{IMAGE} --plugin gone.py", "gone.py: does not exist"),
    (f"{IMAGE} --snr 0:5:5", "'0:5:5'", "one number"),
    (f"{IMAGE} --plot picture.doc", "picture.doc", ".png, .pdf or .svg"),
    (f"{IMAGE} --sensing pss", "unknown sensing 'pss': did you mean 'prs'? allowed are all, prs"),
    ("image -s tiny.toml -e blob[n=[1,2]]", "'blob[n=[1,2]]' names 2 variants"),
    ("image -s tiny.toml -e looked_for_later -o cloud.xyz", "has suffix '.xyz'", ".csv"),
    ("image -s tiny.toml -e looked_for_later -o no/cloud.csv", "there is no folder no"),
    (f"{IMAGE} --cube no.npy", "no.npy"),
    (f"{IMAGE} --cube no.npy --seed 0", "--trial, --seed and --modulation cannot be combined with --cube"),
    (f"{IMAGE} --cube no.npy --modulation 16qam", "cannot be combined with --cube"),
    (f"{IMAGE} --cube no.npy --snr 10", "with --cube, --snr needs --division wiener"),
    (f"{IMAGE} --transmitted grid.npy", "--transmitted needs --cube FILE"),
    (f"{IMAGE} --ascending +u,+w", "--ascending needs --cube FILE"),
    ("merge gone -o all", "gone: not the folder of a run, manifest.json missing"),
    ("rescore gone", "gone: not the folder of a run, manifest.json missing"),
    ("report .", "not the folder of a run", "manifest.json"),
    ("report base same", "several folders, and -o, need --html"),
    ("report base -o a.html", "several folders, and -o, need --html"),
    ("report base --html --snr 10", "--html cannot be combined with"),
    ("report base same --html -o board.txt", "give -o FILE.html"),
    ("report base base --html", "given twice"),
    ("report base --snr 7", "unknown SNR in dB '7': allowed are -20, -5, 10"),
    ("report none --html", "none"),
    ("compare base nowhere", "nowhere: not the folder of a run"),
    ("compare base same --tolerance deviation", "tolerance 'deviation': allowed is"),
    ("compare base same --tolerance deviatoin=5%", "did you mean 'deviation'"),
    ("compare base same --tolerance n_estimated=5%", "no better direction"),
    ("compare base same --alpha 2", "alpha = 2.0: allowed is"),
    ("compare base same --plot my.doc", "my.doc: a picture takes the extension"),
    ("compare base", "only one run was given; give two runs"),
    ("compare base --between chance", "--between and --and must be given together"),
    ("compare base new --between chance --and nomp4d", "between needs exactly one run"),
    ("compare base new --map nomp4d", "map 'nomp4d': allowed is OLD[param=value,...]=NEW"),
    ("compare base new --map nomp4d=nomb4d", "new: no estimator fits 'nomb4d': did you mean"),
    ("compare base new --markdown nowhere/x.md", "x.md: cannot be written: there is no folder nowhere"),
    ("compare base new --junit base", "base: cannot be written: is not a file"),
    ("compare base same --junit same/results.parquet", "is a table of a run and is not overwritten"),
    ("rank scenes -e fft4d", "two estimators or more"),
    ("rank scenes --metric gopsa_m", "unknown score"),
    (
        "simulate -s tiny.toml -o f.npy --precision half",
        "unknown precision 'half'",
        "allowed are single, double",
    ),
]


def test_a_mistake_in_a_command(refused, runs):
    for words, *fragments in CALLS:
        refused(words, *fragments)


KEY = RESOLUTION.replace("separations_cells", "phases")
FILES = [
    ("s.toml", 'kind = "image"\nname = "s"\n', "run s.toml", "kind = 'image'", "'imaging'", "'resolution'"),
    ("s.toml", KEY, "run s.toml", "unknown key phases", "phases_deg", "separations_cells"),
    ("s.toml", "name = 1", "run s.toml", "name = 1"),
    ("e.csv", "x,y,z,v\n", "score e.csv e.csv", "at least one"),
    ("t.csv", CLOUD, "score t.csv gone.csv", "gone.csv", "does not exist"),
    ("t.csv", CLOUD, "score t.csv t.txt", "t.txt", ".csv", ".mat"),
    (
        "t.csv",
        CLOUD,
        "score t.csv t.csv --metric papers",
        "'papers'",
        "allowed are nr-isac, objects, occupancy, paper",
    ),
    ("tiny.csv", "x,y,z,v\n1,2,3,4\n1,nan,3,4\n", IMAGE, "tiny.csv", "row 3", "y is nan"),
    ("tiny.csv", "x,y,z\n1,2,3\n", IMAGE, "tiny.csv", "takes the columns x, y, z, v"),
]


def test_a_mistake_in_a_file(refused):
    for name, text, words, *fragments in FILES:
        Path(name).write_text(text)
        refused(words, *fragments)


@pytest.mark.parametrize(
    ("right", "wrong", "fragments"),
    [
        ("[array]", "[array]\nframme = 1", ["unknown key array.framme", "tx_shape"]),
        ("n_symbols", "n_symbolz", ["n_symbolz", "n_symbols"]),
        ("[system]", "[system]\nsubcarrier_spacing_hz = -1.0", ["subcarrier_spacing_hz", "-1.0", "than 0"]),
        ("y_m = [0.0, 10.0]", "y_m = [-9000.0, 10.0]", ["region", "unambiguous", "624.6 m"]),
    ],
)
def test_a_mistake_in_a_scenario(refused, tiny, right, wrong, fragments):
    Path("bad.toml").write_text(tiny.read_text().replace(right, wrong))
    refused("image -s bad.toml -e blob -o cloud.csv", "bad.toml", *fragments)


def test_wrong_usage_exits_2(cli):
    for words in ("", "run -n 0", "run --bogus", "run --timing --repeats 0", "score one.csv", "nothing"):
        assert cli(*words.split()).exit_code == 2, words
