"""The page in a real browser without network."""

from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page

from cmf_mj.report_2014.page.document import make_content, save_page

pytestmark = pytest.mark.slow

FIGURES = ["2-13", "4-13"]


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
        page.on("console", lambda message: self.complaints.append(message.text))


@pytest.fixture(scope="module")
def visit(path: Path, browser: Browser) -> Visit:
    context = browser.new_context(offline=True, viewport={"width": 1300, "height": 900})
    opened = Visit(context.new_page())
    opened.page.goto(path.as_uri())
    return opened


def test_page_shows_its_figures_and_asks_for_nothing(visit: Visit) -> None:
    widths = visit.page.locator("figure img").evaluate_all("all => all.map(i => i.naturalWidth)")
    assert len(widths) == len(FIGURES) and min(widths) > 400
    assert [url for url in visit.requests if not url.startswith(("file:", "data:"))] == []
    assert visit.complaints == []


def test_the_filter_leaves_what_is_within_or_outside(visit: Visit) -> None:
    shown = "rows => rows.filter(row => row.offsetParent).length"
    rows = visit.page.locator("#table-2-4 tbody tr")
    assert rows.evaluate_all(shown) == 6
    for which in ("within", "outside"):
        visit.page.check(f"#{which}-only")
        assert not visit.page.locator("#figure-2-13").is_visible()
        assert rows.evaluate_all(shown) == visit.page.locator(f"#table-2-4 td.{which}").count()
    visit.page.locator("#filters input").first.check()
    assert visit.page.locator("#figure-2-13").is_visible()


def test_links_of_the_contents_lead_somewhere(visit: Visit) -> None:
    visit.page.locator("nav a", has_text="Models and versions").click()
    top = visit.page.locator("#provenance").evaluate("e => e.getBoundingClientRect().top")
    height = visit.page.viewport_size
    assert height is not None and -1.0 <= top < height["height"]
