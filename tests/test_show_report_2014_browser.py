"""The page in a real browser without network."""

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, sync_playwright

from cmf_mj.show.report_2014.page import make_content, save_page

pytestmark = pytest.mark.slow

FIGURES = ["3-14", "3-17"]


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    content = make_content(FIGURES, [], jobs=2, quick=True)
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
            opened.page.locator(f"#figure-{number} .main-svg").first.wait_for()
        yield opened
        browser.close()


def test_page_asks_for_nothing_and_complains_of_nothing(visit: Visit) -> None:
    assert [url for url in visit.requests if not url.startswith(("file:", "data:", "blob:"))] == []
    assert visit.complaints == []


def test_pointing_at_a_curve_shows_its_value(visit: Visit) -> None:
    plot = visit.page.locator("#figure-3-14 .plot")
    plot.scroll_into_view_if_needed()
    # The pixel of a point of the first curve, from plotly's axes.
    where = plot.evaluate(
        """element => {
            const trace = element._fullData[0], layout = element._fullLayout, i = 200;
            const box = element.getBoundingClientRect();
            return {x: box.left + layout.xaxis._offset + layout.xaxis.d2p(trace.x[i]),
                    y: box.top + layout.yaxis._offset + layout.yaxis.d2p(trace.y[i]),
                    curve: [Array.from(trace.x), Array.from(trace.y)]};
        }"""
    )
    visit.page.mouse.move(where["x"] - 3, where["y"])
    visit.page.mouse.move(where["x"], where["y"])
    hover = visit.page.locator("#figure-3-14 .hovertext").first
    hover.wait_for()
    text = (hover.text_content() or "").replace("\u2212", "-")
    numbers = re.search(r"(-?[0-9.]+), (-?[0-9.]+)", text)
    assert numbers is not None and "position" in text
    hovered = [float(part) for part in numbers.groups()]
    index = min(range(400), key=lambda i: abs(where["curve"][0][i] - hovered[0]))
    assert hovered == pytest.approx([values[index] for values in where["curve"]], rel=1e-3)
    assert 150 < index < 250


def test_zooming_changes_the_axis(visit: Visit) -> None:
    plot = visit.page.locator("#figure-3-17 .plot")
    plot.scroll_into_view_if_needed()
    before = plot.evaluate("element => element._fullLayout.xaxis.range.slice()")
    box = plot.locator(".nsewdrag").first.bounding_box()
    assert box is not None
    middle = box["y"] + 0.5 * box["height"]
    visit.page.mouse.move(box["x"] + 0.3 * box["width"], middle)
    visit.page.mouse.down()
    visit.page.mouse.move(box["x"] + 0.6 * box["width"], middle, steps=4)
    visit.page.mouse.up()
    visit.page.wait_for_timeout(300)
    after = plot.evaluate("element => element._fullLayout.xaxis.range.slice()")
    assert after[1] - after[0] < 0.5 * (before[1] - before[0])


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


def test_printing_draws_every_figure_as_wide_as_the_paper(visit: Visit) -> None:
    widths = "plots => plots.map(plot => plot._fullLayout.width)"
    visit.page.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert visit.page.locator(".plot").evaluate_all(widths) == [680] * len(FIGURES)
    visit.page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert min(visit.page.locator(".plot").evaluate_all(widths)) > 680
