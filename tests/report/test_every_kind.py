"""What every kind of suite gives is laid out by every writer: rows as committed, and of small runs."""

import json
from pathlib import Path

import pandas as pd
import pytest

from isacbench.bench.kinds.link import LinkSuite
from isacbench.bench.run.runner import run
from isacbench.bench.suites.suite_kinds import KINDS
from isacbench.report.figures import draw_charts, styled
from isacbench.report.html.page_content import chart_rows
from isacbench.report.tables import markdown
from tests.report.test_table_texts import printed

REFERENCE = Path(__file__).parents[2] / "results" / "reference"
COMMITTED = {
    "imaging": "printed",
    "efficiency": "efficiency",
    "resolution": "resolution",
    "detection": "detectors",
    "population": "population",
}
FEW = {
    "imaging": "scenario == 'street' and trial < 5",
    "efficiency": "trial < 5",
    "resolution": "trial < 2 and dimension == 'u'",
    "detection": "trial < 1 and scenario in ['homogeneous', 'interferers', 'street']",
    "population": "snr_db == 10 and scenario.str.contains('(?:town|sparse).*[05](?:,|])')",
}
STEMS = {
    "imaging": ["deviation", "curves-street"],
    "efficiency": ["efficiency-single"],
    "resolution": ["resolution-single"],
    "detection": ["maps", "roc", "detection-street"],
    "link": ["link-tiny", "trade-tiny"],
    "population": ["ratios", "scores", "targets-sparse"],
}


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
            assert len(figure.axes) == len(group.charts)
            assert len(figure.legends) == 1
            box = figure.legends[0].get_window_extent()
            assert 0 <= box.x0 < box.x1 <= figure.bbox.width
            assert figure._suptitle.get_window_extent().y0 > max(
                axes.title.get_window_extent().y1 for axes in figure.axes
            )
