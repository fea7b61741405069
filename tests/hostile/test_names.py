"""Names from scenarios, plugins and other people's runs: shown as they are, obeyed by nobody."""

from __future__ import annotations

import csv
import io
import json
import re
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from isacbench.bench.store.run_folder import without_formulas
from isacbench.charts import text_table
from isacbench.files import escaping
from isacbench.files.escaping import escape_control, escape_json, file_stems, in_markdown, shortened
from isacbench.model.cloud import PointCloud
from isacbench.model.scenes.scenario import load_scenario
from isacbench.report.clouds import plot_clouds
from isacbench.report.tables import markdown, terminal_tables
from tests.conftest import refusal

NAMES = {
    "up": "../../etc/passwd",
    "absolute": "/etc/passwd",
    "backslashes": "..\\..\\boot",
    "script": "\"><script>alert('1')</script>",
    "image": "![x](http://example.org/x.png)",
    "link": "[x](javascript:alert(1))",
    "table": "a | b | c",
    "code": "`rm`",
    "mathematics": r"$\frac{1}{$ \alpha_",
    "one dollar": "$",
    "lone backslash": "\\",
    "markup": "[red]a[/red] [/]",
    "lines": "a\nb\r\nc",
    "escape": "\x1b]0;title\x07\x1b[31mred\x9b1m",
    "right to left": "\u202eevil\u2066",
    "Arabic": "شارع",
    "emoji": "🚗👨‍👩‍👧",
    "half": "\udcff",
    "long": "x" * 300,
    "reserved": "CON",
    "option": "--json",
    "formula": '=HYPERLINK("http://example.org")',
    "blank": " ",
    "dots": "..",
}
"""What somebody may call a scenario, an estimator or a file."""

CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
any_text = st.text(st.characters(), max_size=30)


@given(any_text)
def test_what_is_shown_has_no_power_over_a_terminal(text):
    assert not CONTROL.search(escape_control(text))
    assert "\n" not in escape_control(text)
    escape_control(text).encode()  # which halves of characters would not let
    assert escaping.escape_lines(text).count("\n") == text.count("\n")


@given(any_text)
def test_json_means_the_same_as_before(text):
    shown = escape_json(json.dumps({"name": text}, indent=2, ensure_ascii=False))
    assert json.loads(shown) == {"name": text}
    assert not CONTROL.search(shown)


@given(any_text, st.integers(3, 50))
def test_a_long_text_is_shortened_and_a_short_one_is_not(text, most):
    assert len(shortened(text, most)) <= most
    assert len(text) > most or shortened(text, most) == text
    assert escaping.quoted(text, most) == shortened(repr(text), most)


@given(any_text)
def test_nothing_in_a_cell_of_markdown_ends_it_or_begins_a_tag_or_a_link(text):
    shown = in_markdown(text)
    assert not re.search(r"(?<!\\)(\\\\)*[|`*$]", shown)
    assert "<" not in shown
    assert "](" not in shown
    assert "\n" not in shown


def test_tables_keep_their_shape():
    for name in NAMES.values():
        lines = markdown(text_table(name, ["SNR [dB]", name], [["0", name], ["10", "x"]])).split("\n")
        assert len(lines) == 7
        assert all(len(re.findall(r"(?<!\\)\|", line)) == 3 for line in lines[2:6]), name
        assert "<script" not in "\n".join(lines)


def test_a_terminal_shows_what_a_table_holds():
    for name in NAMES.values():
        console = Console(file=io.StringIO(), width=700, force_terminal=True, color_system=None)
        console.print(*terminal_tables(text_table(name, ["SNR [dB]", name], [["0", name]]), 700))
        shown = console.file.getvalue()
        plain = re.sub("\x1b\\[[0-9;]*m", "", shown) if "\x1b" not in escape_control(name) else shown
        assert not CONTROL.search(plain), name
        if name.strip() and len(name) < 100 and " [" not in name and ": " not in name:
            assert escape_control(name) in shown


@given(st.lists(any_text, max_size=6, unique=True))
def test_stems_of_files_have_no_folder_and_tell_names_apart_on_every_system(texts):
    stems = file_stems(texts)
    assert all(re.fullmatch(r"[A-Za-z0-9_-]{1,70}", stem) for stem in stems.values())
    assert not any(stem.startswith("-") for stem in stems.values())
    assert len({stem.lower() for stem in stems.values()}) == len(texts)


ALONE = ("lone backslash", "long", "blank")
"""What means something at the end of a text, or has it take no room or too much."""

TITLES = [*(NAMES[key] for key in ALONE), " ".join(name for key, name in NAMES.items() if key not in ALONE)]
PICTURES = [*((".svg", title) for title in TITLES), (".png", TITLES[-1]), (".pdf", TITLES[-1])]


@pytest.mark.parametrize(("suffix", "title"), PICTURES, ids=range(len(PICTURES)))
def test_pictures_are_drawn_whatever_their_title(tmp_path, suffix, title):
    path = tmp_path / f"picture{suffix}"
    plot_clouds(None, {title: PointCloud.empty()}, title=title, out=path)
    if suffix == ".svg":
        text = path.read_text(encoding="utf-8")
        ElementTree.fromstring(text)
        assert "<script" not in text
    assert [found.name for found in tmp_path.iterdir() if found.suffix == suffix] == [path.name]


def test_a_scenario_keeps_its_name_or_is_refused(tiny):
    text = tiny.read_text()
    for name in (name for key, name in NAMES.items() if key != "half"):
        renamed = text.replace('name = "tiny"', f"name = {json.dumps(name, ensure_ascii=False)}")
        tiny.write_text(renamed, encoding="utf-8")
        if len(name) > 200:
            assert re.search("name = 'xxx.*at most 200 characters", refusal(load_scenario, tiny))
        else:
            assert load_scenario(tiny).name == name


def test_a_scenario_reads_no_points_outside_of_its_folder(tmp_path, tiny):
    inside = tmp_path / "inside"
    (inside / "folder").mkdir(parents=True)
    (tmp_path / "outside.csv").write_text("x,y,z,v\n5,5,1,0\nsecret,1,2,3\n")
    for link in ("link.csv", "folder/link.csv"):
        (inside / link).symlink_to(tmp_path / "outside.csv")
    path = inside / "tiny.toml"
    for file in ("../outside.csv", "/etc/passwd", "link.csv", "folder/link.csv"):
        path.write_text(tiny.read_text().replace('"tiny.csv"', json.dumps(file)))
        message = refusal(load_scenario, path)
        assert "leads out of the folder" in message
        assert "secret" not in message, file


def test_a_scenario_reads_points_in_its_folder_and_below(tmp_path, tiny):
    (tmp_path / "folder").mkdir()
    for place in ("points.csv", "folder/points.csv"):
        (tmp_path / place).write_text("x,y,z,v\n5,5,1,0\n")
    (tmp_path / "link.csv").symlink_to("folder/points.csv")
    text = tiny.read_text()
    for file in ("points.csv", "folder/points.csv", "folder/../points.csv", "./points.csv", "link.csv"):
        tiny.write_text(text.replace('"tiny.csv"', json.dumps(file)))
        assert len(load_scenario(tiny).truth) == 1, file


def test_a_spreadsheet_computes_nothing():
    texts = ["=1+1", "+1", "-1", "@SUM(A1)", "\t=1", "\r=1"]
    table = pd.DataFrame({"scenario": [*texts, "street", None], "snr_db": np.arange(-1.0, 7)})
    guarded = without_formulas(table)
    assert guarded["scenario"].tolist()[:-1] == [*(f"'{text}" for text in texts), "street"]
    assert guarded["scenario"].isna().tolist() == [False] * 7 + [True]
    assert guarded["snr_db"].tolist() == table["snr_db"].tolist()
    rows = list(csv.reader(io.StringIO(guarded.to_csv(index=False), newline="")))
    assert [row[0][0] for row in rows[1:7]] == ["'"] * 6
