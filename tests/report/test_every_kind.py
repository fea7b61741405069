"""Writers of tables and charts: of every kind of suite, with few rows, and of any table."""

import io
import json
import re
from pathlib import Path

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from isacbench.bench.kinds.link import LinkSuite
from isacbench.bench.run.runner import run
from isacbench.bench.suites.suite_kinds import KINDS
from isacbench.charts import Column, Table, text_table
from isacbench.files.escaping import in_markdown
from isacbench.report.figures import draw_charts, styled
from isacbench.report.html.page_content import chart_rows
from isacbench.report.tables import markdown, terminal_tables

REFERENCE = Path(__file__).parents[2] / "results" / "reference"
COMMITTED = {
    "imaging": "printed",
    "efficiency": "efficiency",
    "resolution": "resolution",
    "detection": "detectors",
    "population": "population",
    "drops": "uma-av",
}
FEW = {
    "imaging": "scenario == 'street' and trial < 5",
    "efficiency": "trial < 5 and estimator in ['fft4d', 'music2d', 'nomp4d']",
    "resolution": "trial < 2 and dimension == 'u'",
    "detection": "trial < 1 and scenario in ['homogeneous', 'interferers', 'street']",
    "population": "snr_db == 10 and scenario.str.contains('(?:town|sparse).*[05](?:,|])')"
    " and estimator in ['empty', 'chance', 'fft4d', 'music2d', 'oracle']",
    "drops": "snr_db >= -15 and estimator in ['fft4d', 'nomp4d']",
}
STEMS = {
    "imaging": ["deviation", "curves-street"],
    "efficiency": ["efficiency-single"],
    "resolution": ["resolution-single"],
    "detection": ["maps", "roc", "detection-street"],
    "link": ["link-tiny", "trade-tiny"],
    "population": ["ratios", "scores", "targets-sparse"],
    "drops": ["drops-uma-av"],
}


def printed(table, width):
    """Lines of a table in a terminal of some width."""
    console = Console(width=width, record=True, file=io.StringIO())
    for part in terminal_tables(table, width):
        console.print(part)
    return [line.rstrip() for line in console.export_text().splitlines()]


@pytest.fixture(scope="module")
def seen():
    """Rows by kind, once they were read or made."""
    return {}


@pytest.fixture(params=KINDS)
def kind(request):
    return request.param


@pytest.fixture
def rows(kind, seen, plugins, tiny):
    """Some rows of a kind."""
    if kind in seen:
        return seen[kind]
    if kind == "link":
        common = {"name": "test", "scenarios": [str(tiny)], "estimators": ["blob"], "channels": ["awgn"]}
        found = run(LinkSuite(**common, modulations=["qpsk", "16qam"], snr_db=[0, 20], trials=2))
    else:
        found = pd.read_parquet(REFERENCE / COMMITTED[kind] / "results.parquet").query(FEW[kind])
    seen[kind] = found.reset_index(drop=True)
    return seen[kind]


def test_tables_keep_to_the_width_of_a_terminal_and_markdown_has_every_text(kind, rows):
    tables = KINDS[kind].tables(rows)
    assert not all(table.is_detail for table in tables)
    for table in tables:
        assert all(len(texts) == len(table.headings) for texts in table.texts)
        text = markdown(table)
        assert text.count("\n") == len(table.texts) + 4
        for width in () if table.is_detail else (60, 100, 200):
            lines = printed(table, width)
            assert max(map(len, lines)) <= width
            assert len(lines) > len(table.texts)


def test_charts_have_named_axes_and_are_drawn_and_are_json_for_the_page(kind, rows):
    groups = KINDS[kind].charts(rows)
    assert [group.stem for group in groups] == STEMS[kind]
    described = chart_rows(groups)
    assert json.loads(json.dumps(described, allow_nan=False)) == described
    assert len(described) == sum(len(group.charts) for group in groups)
    for chart in (chart for group in groups for chart in group.charts):
        assert chart.x.title
        assert chart.y.title or chart.y.categories
        assert chart.y.title != "mean"
    styles = {}
    for one in (one for group in groups for chart in group.charts for one in chart.series):
        if one.mark == "line":
            styles.setdefault(one.label, set()).add(one.style)
    assert (
        all(len(found) == 1 for found in styles.values()) or kind == "link"
    )  # colours are modulations there
    with styled():
        for group in groups:
            figure = draw_charts(group)
            figure.draw_without_rendering()
            assert len(figure.axes) == sum(bool(chart.series) for chart in group.charts)
            assert len(figure.legends) == 1
            box = figure.legends[0].get_window_extent()
            assert 0 <= box.x0 < box.x1 <= figure.bbox.width
            assert figure._suptitle.get_window_extent().y0 > max(
                axes.title.get_window_extent().y1 for axes in figure.axes
            )


# Any table

texts = st.text("ab[]|=,. 1", max_size=30)


@st.composite
def tables(draw):
    n = draw(st.integers(1, 9))
    columns = [
        Column(
            draw(texts),
            place,
            optional=draw(st.integers(0, 3)) if place else 0,
            part=min(place, 1 + place % 4),
        )
        for place in range(n)
    ]
    rows = draw(st.lists(st.lists(texts, min_size=n, max_size=n), max_size=3))
    return Table(draw(texts), columns, [dict(enumerate(row)) for row in rows])


@given(tables(), st.integers(60, 200))
def test_any_table_keeps_to_the_width_of_the_terminal(table, width):
    assert all(len(line) <= width for line in printed(table, width))


@given(tables())
def test_markdown_has_every_text_in_its_cell(table):
    lines = markdown(table).split("\n")
    assert lines[0] == f"**{in_markdown(table.title)}**"
    cells = [re.split(r"(?<!\\)\|", line)[1:-1] for line in [lines[2], *lines[4:-1]]]
    expected = [[f" {in_markdown(text)} " for text in row] for row in (table.headings, *table.texts)]
    assert cells == expected


def wide(n_columns, **options):
    columns = [Column("name", "name", part=0)]
    columns += [Column(f"column {k}", "x", part=k + 1, **options) for k in range(n_columns)]
    return Table("title", columns, [{"name": "first", "x": "0.123 ±0.456"}])


def test_without_room_optional_columns_go_the_most_optional_first():
    columns = [Column("name", "n", part=0), *(Column(f"level{k}", "x", optional=k) for k in (0, 1, 2, 2))]
    table = Table("", columns, [{"n": "a", "x": "y" * 20}])
    shown = [
        [k for k in range(3) if f"level{k}" in "".join(printed(table, width))] for width in (120, 60, 30)
    ]
    assert shown == [[0, 1, 2], [0, 1], [0]]


def test_then_parts_stand_below_each_other_and_each_has_the_names_of_its_rows():
    lines = printed(wide(12), 80)
    text = "\n".join(lines)
    assert all(f"column {k}" in text for k in range(12))
    assert sum("first" in line for line in lines) == sum("name" in line for line in lines) > 1
    assert sum("first" in line for line in printed(wide(12), 300)) == 1


def test_last_lines_are_broken_and_no_letter_is_lost():
    reason = "why " * 60 + "end"
    text = " ".join(" ".join(printed(text_table("", ["reason", "cells"], [[reason, "4"]]), 60)).split())
    assert text.count("why") == 60
    assert "end" in text


def test_brackets_are_parameters_and_units_and_long_names_have_lines_of_their_own():
    label = "music2d[detector=ca[pfa=1e-4],angle_points=128]"
    lines = printed(text_table("blob[n=5]", ["SNR [dB]", f"{label}: deviation"], [["0", "[red]x"]]), 100)
    text = "\n".join(lines)
    assert "blob[n=5]" in text
    assert "[dB]" in text
    assert "[red]x" in text
    for piece in ("music2d", "[detector=ca", "[pfa=1e-4],angle_points=128]", "deviation"):
        assert any(line.rstrip().endswith(piece) for line in lines), piece


def test_of_a_pair_of_estimators_the_second_stands_below_the_first():
    lines = printed(text_table("", ["curve"], [["street, blob → nomp4d"]]), 60)
    assert [line.strip() for line in lines[-3:] if line] == ["street, blob", "→ nomp4d"]


@pytest.mark.parametrize("width", [60, 200])
def test_a_table_without_rows_or_columns_of_numbers_is_shown(width):
    assert any("name" in line for line in printed(text_table("t", ["name"], []), width))
