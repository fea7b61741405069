"""Writers of tables: within the width of a terminal, whole in Markdown."""

import io
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from isacbench.charts import Column, Table, text_table
from isacbench.files.escaping import in_markdown
from isacbench.report.tables import markdown, terminal_tables


def printed(table, width):
    """Lines of a table in a terminal of some width."""
    console = Console(width=width, record=True, file=io.StringIO())
    for part in terminal_tables(table, width):
        console.print(part)
    return [line.rstrip() for line in console.export_text().splitlines()]


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
