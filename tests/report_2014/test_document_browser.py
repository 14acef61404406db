"""The page in a real browser without network."""

import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Locator, Page, sync_playwright

from cmf_mj.report_2014.page.document import make_content, save_page

pytestmark = pytest.mark.slow

FIGURES = ["3-14", "3-17"]


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    content = make_content(FIGURES, ["2-4"], jobs=2, quick=True)
    return save_page(content, tmp_path_factory.mktemp("report"))


class Visit:
    """A page with all it asked for and complained about."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.requests: list[str] = []
        self.complaints: list[str] = []
        page.on("request", lambda request: self.requests.append(request.url))
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on(
            "console",
            lambda message: (
                self.complaints.append(message.text)
                if message.type in ("error", "warning")
                else None
            ),
        )


@pytest.fixture(scope="module")
def visit(path: Path) -> Iterator[Visit]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        context = browser.new_context(offline=True, viewport={"width": 1300, "height": 900})
        opened = Visit(context.new_page())
        opened.page.goto(path.as_uri())
        for number in FIGURES:
            opened.page.locator(f"#figure-{number}").scroll_into_view_if_needed()
            opened.page.locator(f"#figure-{number} .legend button").first.wait_for()
        yield opened
        browser.close()


def test_page_asks_for_nothing_and_complains_of_nothing(visit: Visit) -> None:
    assert [url for url in visit.requests if not url.startswith(("file:", "data:", "blob:"))] == []
    assert visit.complaints == []


def curve_of(visit: Visit, figure: str, name: str) -> list[list[float]]:
    """Points of a curve as the page has them."""
    text = visit.page.locator(f"#{figure} script").text_content()
    panel = json.loads(text or "")["panels"][0]
    (curve,) = [curve for curve in panel["curves"] if curve["name"] == name]
    return [curve["x"], curve["y"]]


def test_pointing_at_a_curve_shows_its_value(visit: Visit) -> None:
    plot = visit.page.locator("#figure-3-14 .plot")
    plot.scroll_into_view_if_needed()
    # The middle of the length of the first curve, on the screen.
    where = plot.evaluate(
        """element => {
            const line = element.querySelector("g polyline");
            const svg = element.querySelector(":scope > svg");
            const point = line.getPointAtLength(0.5 * line.getTotalLength());
            const box = svg.getBoundingClientRect(), scale = box.width / svg.viewBox.baseVal.width;
            return {x: box.left + scale * point.x, y: box.top + scale * point.y};
        }"""
    )
    visit.page.mouse.move(where["x"] - 3, where["y"])
    visit.page.mouse.move(where["x"], where["y"])
    text = (plot.locator(".readout").text_content() or "").replace("\u2212", "-")
    numbers = re.search(r"(-?[0-9.]+), (-?[0-9.]+)  (.+)", text)
    assert numbers is not None and numbers[3] == "position"
    frequency, gain = float(numbers[1]), float(numbers[2])
    x, y = curve_of(visit, "figure-3-14", "position")
    assert gain == pytest.approx(np.interp(np.log(frequency), np.log(x), y), abs=0.1)


def labels(plot: Locator) -> list[float]:
    """Numbers below the x axis."""
    texts = plot.locator("text[text-anchor=middle]").all_text_contents()
    return [float(text.replace("\u2212", "-")) for text in texts if text[-1].isdigit()]


def test_zooming_changes_the_axis_and_two_clicks_bring_it_back(visit: Visit) -> None:
    plot = visit.page.locator("#figure-3-17 .plot")
    plot.scroll_into_view_if_needed()
    before, box = labels(plot), plot.bounding_box()
    assert box is not None
    middle = box["y"] + 0.25 * box["height"]
    visit.page.mouse.move(box["x"] + 0.3 * box["width"], middle)
    visit.page.mouse.down()
    visit.page.mouse.move(box["x"] + 0.6 * box["width"], middle, steps=4)
    visit.page.mouse.up()
    after = labels(plot)
    assert after[-1] - after[0] < 0.5 * (before[-1] - before[0])
    visit.page.mouse.dblclick(box["x"] + 0.5 * box["width"], middle)
    assert labels(plot) == before


def test_a_click_in_the_legend_takes_a_curve_away(visit: Visit) -> None:
    plot = visit.page.locator("#figure-3-14 .plot")
    lines = plot.locator("g polyline")
    before = lines.count()
    plot.locator(".legend button").first.click()
    assert lines.count() == before - 2  # of gain and phase
    plot.locator(".legend button").first.click()
    assert lines.count() == before


def test_filters_leave_a_chapter_or_what_is_outside(visit: Visit) -> None:
    shown = "rows => rows.filter(row => row.offsetParent).length"
    rows = visit.page.locator("#table-2-4 tbody tr")
    assert rows.evaluate_all(shown) == 6
    visit.page.select_option("#verdict", "within")
    assert not visit.page.locator("#figure-3-14").is_visible()
    assert rows.evaluate_all(shown) == visit.page.locator("#table-2-4 td.within").count() > 0
    visit.page.select_option("#verdict", "")
    visit.page.select_option("#chapter", "chapter-3")
    assert not visit.page.locator("#table-2-4").is_visible()
    assert visit.page.locator("#figure-3-14").is_visible()
    visit.page.evaluate("document.querySelector('a[href=\"#table-2-4\"]').click()")
    assert rows.evaluate_all(shown) == 6


def test_links_of_the_contents_lead_somewhere(visit: Visit) -> None:
    broken = visit.page.evaluate(
        """() => [...document.querySelectorAll('nav a')]
            .map(a => a.getAttribute('href').slice(1)).filter(id => !document.getElementById(id))"""
    )
    assert broken == []
    visit.page.locator("nav a", has_text="Models, versions and seed").click()
    top = visit.page.locator("#provenance").evaluate("e => e.getBoundingClientRect().top")
    height = visit.page.viewport_size
    assert height is not None and -1.0 <= top < height["height"]


def test_printing_draws_every_figure(visit: Visit) -> None:
    """None has been near the window since the page was opened, and the paper has them all."""
    visit.page.reload()
    drawn = visit.page.locator(".plot > svg")
    assert drawn.count() < len(FIGURES)
    visit.page.evaluate("dispatchEvent(new Event('beforeprint'))")
    widths = "plots => plots.map(plot => plot.viewBox.baseVal.width)"
    assert drawn.evaluate_all(widths) == [900] * len(FIGURES)
