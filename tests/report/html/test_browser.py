"""Pages in a real browser: what they draw, what their controls do, and what they let nobody do."""

import csv
import io
from functools import cache
from urllib.parse import unquote

import numpy as np
import pytest
from matplotlib.image import imread

from isacbench.bench.compare.comparison import compare
from isacbench.bench.kinds.scores import average_scenarios, summarise_scores
from isacbench.bench.store.run import Run, load_run
from isacbench.metrics.geometry import CloudPair
from isacbench.report.html.written_pages import (
    write_comparison_page,
    write_leaderboard,
    write_rank_page,
    write_run_page,
)
from tests.conftest import slow_but
from tests.report.html.conftest import known

pytestmark = pytest.mark.first

READY = "body[data-ready]"
NO_AXE = "no axe: pip install axe-playwright-python"

HARMLESS = "willReadFrequently", "GPU stall due to ReadPixels"
"""Parts of messages that are no faults: hints of the browser on how plotly draws text and on slow drawing."""


@pytest.fixture(scope="module")
def pages(runs, tmp_path_factory):
    """Paths of written pages by name."""
    folder = tmp_path_factory.mktemp("pages")

    @cache
    def make(name):
        if name == "comparison":
            between = compare(runs("images"), between=("music2d", "fft4d"))
            return write_comparison_page(between, [Run.open(runs("images"))])
        if name == "leaderboard":
            return write_leaderboard([Run.open(runs(one)) for one in ("images", "other")], folder / "b.html")
        if name == "scenes":
            return write_rank_page(Run.open(runs(name)))
        with known():
            return write_run_page(Run.open(runs(name)))

    return make


@pytest.fixture(scope="module")
def tabs():
    """Open pages by their names, and what was logged or requested in any, which the fixture `visit` reads."""
    known_tabs = {}
    yield known_tabs, []
    close(known_tabs)


def close(known_tabs):
    """Close all pages: in those that nobody looks at, plotly is busy all the same."""
    while known_tabs:
        known_tabs.popitem()[1].context.close()


@pytest.fixture
def visit(browser, pages, tabs):
    """Open pages at an address; at the end no fault may have been logged, and nothing requested.

    The page that is open is led to the address, unless it is another or `anew` asks for a new tab.
    """
    known_tabs, faults = tabs

    def opened(name, address="", width=700, scheme="light", anew=False):
        page = known_tabs.get(name)
        if page and not anew:
            page.set_viewport_size({"width": width, "height": 600})
            page.emulate_media(color_scheme=scheme)
            for one in ("", address):  # an address that is there already draws nothing anew
                page.evaluate("one => (location.hash = one)", one)
                page.wait_for_timeout(20)
            return page
        close(known_tabs)
        context = browser.new_context(
            viewport={"width": width, "height": 600}, color_scheme=scheme, accept_downloads=True
        )
        context.set_default_timeout(20_000)
        page = known_tabs[name] = context.new_page()
        page.on("console", lambda message: faults.append(message.text))
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.on("dialog", lambda dialog: (faults.append(dialog.message), dialog.dismiss()))
        own = pages(name).as_uri()
        page.on(
            "request",
            lambda request: (
                None if request.url.startswith((own, "blob:", "data:")) else faults.append(request.url)
            ),
        )
        page.goto(f"{own}{address}")
        page.wait_for_selector(READY)
        return page

    faults.clear()
    yield opened
    assert [fault for fault in faults if not any(words in fault for words in HARMLESS)] == []


def settle(page):
    """Wait until all figures of the view are drawn."""
    wait_for(page, "!document.querySelector('.plot:not([hidden]):not(.js-plotly-plot)')")
    page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")


def wait_for(page, condition):
    """Wait until a condition holds; the policy of the page forbids playwright to evaluate it by itself."""
    for _ in range(400):
        if page.evaluate(condition):
            return
        page.wait_for_timeout(50)
    pytest.fail(f"waited 20 s in vain for {condition}")


def views_of(page):
    return page.locator("nav a")


def go_to(page, title):
    page.locator("nav a", has_text=title).first.click()
    settle(page)


PAGES = {
    "images": ["Overview", "Curves", "Images", "Maps", "Rows"],
    "scenes": ["Overview", "Curves", "Images", "Scenes", "Rows"],
    "comparison": ["Comparison", "Overview", "Curves", "Images", "Rows"],
    "leaderboard": ["Overview", "Curves", "Images", "Rows"],
    "timed": ["Overview", "Curves", "Images", "Maps", "Time against error", "Rows"],
    "link": ["Overview", "Curves", "Images", "Scenes", "Link", "Rows"],
    "detection": ["Overview", "Curves", "Images", "Detectors", "Rows"],
    "hostile": ["Overview", "Curves", "Images", "Maps", "Rows"],
}


def test_the_page_can_be_used_with_the_keyboard_alone_and_shows_and_keeps_the_focus(visit):
    page = visit("images", "#est=fft4d", anew=True)
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.textContent") == "Skip to the content"
    for _ in range(3):
        page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.textContent") == "Images"
    assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"
    page.keyboard.press("Enter")
    settle(page)
    for _ in range(20):
        if page.evaluate("document.activeElement.type") == "range":
            break
        page.keyboard.press("Tab")
    page.keyboard.press("ArrowLeft")
    assert "snr=-10" in page.evaluate("location.hash")
    assert page.evaluate("document.activeElement.getAttribute('aria-valuetext')") == "-10 dB"
    go_to(page, "Overview")
    page.locator("th button", has_text="F-score").first.focus()
    page.keyboard.press("Enter")  # which draws the control anew
    settle(page)
    assert page.evaluate("document.activeElement.textContent") == "F-score"
    assert page.locator("th[aria-sort]").first.inner_text().startswith("F-score")


@pytest.mark.parametrize("name", slow_but(["images"], PAGES))
def test_every_view_opens_without_a_fault_a_barrier_or_a_bar_below_it(visit, name):
    page = visit(name, "#est=fft4d", width=390 if name == "comparison" else 700)
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason=NO_AXE)
    assert views_of(page).all_inner_texts() == PAGES[name]
    for title in PAGES[name]:
        go_to(page, title)
        assert page.locator("nav a[aria-current]").inner_text() == title
        assert page.locator("main").inner_text().strip()
        hold_to_rules(page, axe)
        width = page.evaluate("document.documentElement.scrollWidth - innerWidth")
        assert width <= 0, f"{title} is {width} px too wide"


def hold_to_rules(page, axe):
    """Hold a view to the rules of accessibility."""
    found = axe.Axe().run(page).response["violations"]
    assert not found, [(one["id"], [node["html"][:200] for node in one["nodes"][:3]]) for one in found]


@pytest.mark.slow
@pytest.mark.parametrize("name", PAGES)
def test_every_control_of_every_view_can_be_used_also_in_the_dark(visit, name):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason=NO_AXE)
    page = visit(name, "#est=fft4d", scheme="dark")
    for title in PAGES[name]:
        go_to(page, title)
        hold_to_rules(page, axe)
        for kind in ("select", "input[type=range]", "input[type=checkbox]", "summary", "th button"):
            for index in range(min(page.locator(f"main {kind}").count(), 3)):
                use(page.locator(f"main {kind}").nth(index), kind)
        settle(page)
        assert page.locator("main").inner_text().strip()


def use(control, kind):
    """Use a control in every way, where it can be used."""
    if not control.is_visible() or not control.is_enabled():
        return
    if kind == "select":
        for value in control.evaluate("one => [...one.options].map(option => option.value)")[-2:]:
            control.select_option(value)
    elif kind == "input[type=range]":
        for key in ("End", "Home"):
            control.press(key)
    else:
        control.click()


def share_drawn(png, colours):
    """Share of the pixels of a picture that have one of some colours."""
    pixels = (255 * imread(io.BytesIO(png))[..., :3]).round().astype(int)
    wanted = [[int(colour[at : at + 2], 16) for at in (1, 3, 5)] for colour in colours]
    return np.mean([np.abs(pixels - one).max(axis=-1) <= 12 for one in wanted], axis=(1, 2))


def test_clouds_are_really_drawn_in_the_colours_of_found_and_missed(visit):
    page = visit("images", "#view=images&colour=found&est=fft4d&snr=10")
    settle(page)
    found, missed = "#0072b2", "#7d3c98"
    truth, estimate = (page.locator("figure .plot").nth(place).screenshot() for place in (0, 1))
    assert min(share_drawn(estimate, [found, missed])) > 1e-4
    assert max(share_drawn(truth, [found, missed])) == 0
    hide = page.locator("summary", has_text="Objects")
    hide.click()
    page.locator("button", has_text="All off").click()
    settle(page)
    assert max(share_drawn(page.locator("figure .plot").nth(1).screenshot(), [found, missed])) < 1e-5


EYES = "[...document.querySelectorAll('.clouds .plot')].map(one => one._fullLayout.scene.camera.eye)"


def test_a_key_turns_all_clouds_and_the_address_keeps_the_view(visit):
    page = visit("images", "#view=images&est=fft4d&snr=10")
    settle(page)
    before = page.evaluate(EYES)
    for _ in range(6):  # faster than clouds are drawn
        page.locator(".clouds .plot").nth(1).press("ArrowRight")
    wait_for(page, f"{EYES}.every(eye => Math.abs(eye.x - cameraOf().eye.x) < 0.002)")
    eyes = page.evaluate(EYES)
    turned = np.subtract(*(np.arctan2(eye["y"], eye["x"]) for eye in (eyes[0], before[0])))
    assert turned == pytest.approx(6 * 0.12, abs=0.01)
    assert len(eyes) == 2
    assert all(eye == pytest.approx(eyes[0], abs=2e-3) for eye in eyes)
    other = visit("images", page.evaluate("location.hash"), anew=True)
    settle(other)
    assert other.evaluate(EYES)[0] == pytest.approx(eyes[0], abs=2e-3)
    assert other.locator("fieldset input:checked").count() == 1


def test_a_point_of_a_curve_opens_its_trials_and_a_trial_its_image(visit):
    page = visit("images", "#view=curves")
    settle(page)
    page.evaluate(
        "document.querySelector('.plot').emit('plotly_click',"
        " {points: [{customdata: 10, data: {legendgroup: 'music2d'}}]})"
    )
    assert page.locator("h2", has_text="Trials of music2d at 10 dB").count() == 1
    rows = page.locator("tbody tr")
    assert rows.count() == 10
    rows.nth(0).locator("a").click()
    settle(page)
    address = unquote(page.evaluate("location.hash"))
    assert "view=images" in address
    assert "est=music2d" in address
    page.go_back()
    assert page.locator("h2", has_text="Trials of music2d at 10 dB").count() == 1


def test_curves_and_distances_of_the_page_are_those_of_the_tables_and_the_metric(visit, runs):
    page, stored = visit("images"), load_run(runs("images"))
    wanted = summarise_scores(stored.rows)
    for number, name in enumerate(["fft4d", "music2d", "oracle"]):
        for metric in ("deviation", "gospa_m", "recall"):
            got = page.evaluate(f"curveOf('yard', {number}, metricOf('{metric}'))")
            rows = wanted[wanted["estimator"] == name].sort_values("snr_db")
            assert got["x"] == rows["snr_db"].tolist()
            np.testing.assert_allclose(got["y"], rows[f"{metric}_mean"], rtol=1e-4, atol=1e-9)
            half = np.subtract(got["high"], got["y"])
            np.testing.assert_allclose(half, rows[f"{metric}_band"], rtol=1e-3, atol=1e-4)
    # Nearest neighbours, and the pairs that make each Hausdorff distance.
    row = stored.rows[(stored.rows["estimator"] == "music2d") & (stored.rows["trial"] == 2)].iloc[0]
    truth, cloud = stored.truth(row), stored.cloud(row)
    got = page.evaluate(
        f"(() => {{ const {{ pair }} = imageOf(0, 1, {row['snr_db']}, 2);"
        "return { near: [...pair.ofCloud.distance], planes: pair.planes }; })()"
    )
    np.testing.assert_allclose(got["near"], CloudPair(truth, cloud).estimate_to_truth_m, atol=2e-3)
    for plane, axes in (("xy", [0, 1]), ("xz", [0, 2]), ("yz", [1, 2])):
        own = got["planes"][plane]
        assert own["distance"] == pytest.approx(row[f"hausdorff_{plane}_m"], abs=2e-3)
        apart = truth.xyz[own["truth"], axes] - cloud.xyz[own["point"], axes]
        assert np.linalg.norm(apart) == pytest.approx(own["distance"], abs=2e-3)


def test_filtered_rows_are_saved_as_csv_without_formulas_and_figures_as_svg_and_png(visit):
    page = visit("images", "#view=rows&snr=10&est=fft4d")
    with page.expect_download() as saved:
        page.locator("button", has_text="Save rows as CSV").click()
    rows = list(csv.DictReader(io.StringIO(saved.value.path().read_text(encoding="utf-8"))))
    assert {(row["estimator"], row["SNR [dB]"]) for row in rows} == {("fft4d", "10")}
    assert len(rows) == 10
    assert page.evaluate("csvCell('=1+1')") == '"\'=1+1"'
    go_to(page, "Curves")
    for form, start in (("SVG", b"<svg"), ("PNG", b"\x89PNG")):
        with page.expect_download() as saved:
            page.locator("button", has_text=f"Save {form}").first.click()
        assert saved.value.path().read_bytes().startswith(start)


def test_a_link_to_the_mean_over_scenes_opens_it_and_its_curves_take_the_scene_as_the_unit(visit, runs):
    page = visit("scenes", "#view=curves")
    page.get_by_label("Scene").select_option("*")
    other = visit("scenes", page.evaluate("location.hash"))
    assert other.get_by_label("Scene").input_value() == "*"
    assert "means over scenes" in other.locator("main").inner_text()
    wanted = average_scenarios(load_run(runs("scenes")).rows)
    for number, name in enumerate(["fft4d", "music2d"]):
        got = other.evaluate(f"curveOf('', {number}, metricOf('deviation'))")
        row = wanted[wanted["estimator"] == name].iloc[0]
        assert got["y"] == pytest.approx([row["deviation_mean"]], rel=1e-4)
        assert got["high"][0] - got["y"][0] == pytest.approx(row["deviation_band"], rel=1e-3)


def test_hostile_names_and_reasons_of_failures_are_text_and_nothing_else(visit):
    page = visit("hostile")
    for title in PAGES["hostile"]:
        go_to(page, title)
        assert page.locator("main img, main script, main iframe, main b").count() == 0
        assert page.locator(".plot a").count() == 0
    assert page.locator("script").count() == 5  # three of data, the page's own, and plotly's
    go_to(page, "Overview")
    text = page.locator("main").inner_text()
    assert "Failed cells: 2" in text
    assert "ValueError: <img src=x onerror=alert(1)>" in text


def test_an_address_that_is_nonsense_opens_the_page_all_the_same(visit):
    page = visit(
        "hostile",
        "#view=__proto__&snr=abc&trial=-7&scene=%3Cb%3E&est=none&est=fft4d&metric=__proto__&camera=1,x",
    )
    assert page.locator("nav a[aria-current]").inner_text() == "Overview"
    go_to(page, "Images")
    assert "__proto__" not in page.evaluate("location.hash")
