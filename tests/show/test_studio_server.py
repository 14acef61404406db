"""The studio in a real headless Chromium, software WebGL: what a user of the page sees and does.

Every check waits for one condition; nothing sleeps for luck on a busy machine.
"""

import io
import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
import viser
from playwright.sync_api import Browser, Page

from cmf_mj.control.law import law_names
from cmf_mj.facility.host.stream import read_stream
from cmf_mj.facility.scenario import load_scenario
from cmf_mj.pilot.cueing import cue
from cmf_mj.pilot.flight import load_flight
from cmf_mj.plant.events import KINDS
from cmf_mj.show.studio import controls, desk, live
from cmf_mj.show.studio.server import Page as StudioPage
from cmf_mj.show.studio.server import Studio

pytestmark = pytest.mark.slow

PATIENCE = 300_000
"""Longest wait for anything on the page [ms]: WebGL in software is slow on a busy machine, and only
something that never comes is a failure."""


@pytest.fixture(scope="module")
def studio() -> Iterator[Studio]:
    running = Studio(port=8461)
    yield running
    running.stop()


class Tab:
    """A tab and the session behind it."""

    def __init__(self, browser: Browser, studio: Studio) -> None:
        known = set(studio.pages)
        self.errors: list[str] = []
        # Half the resolution: a quarter of the pixels to draw in software for each tab.
        self.page: Page = browser.new_page(
            viewport={"width": 960, "height": 480}, device_scale_factor=0.5
        )
        self.page.set_default_timeout(PATIENCE)
        self.page.on("console", self._said)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.goto(studio.url)
        self.status("real-time factor")
        (self.behind,) = set(studio.pages) - known

    def _said(self, message: object) -> None:
        if getattr(message, "type", "") == "error":
            self.errors.append(getattr(message, "text", ""))

    def wait(self, condition: Callable[[], bool]) -> None:
        until = time.monotonic() + PATIENCE / 1000.0
        while not condition():
            assert time.monotonic() < until, "the page did not get there in time"
            self.page.wait_for_timeout(100)

    def status(self, text: str) -> str:
        line = self.page.get_by_text(re.compile(text)).first
        line.wait_for()
        return line.inner_text()

    def press(self, name: str) -> None:
        self.page.get_by_role("button", name=name, exact=True).click()

    def choose(self, label: str, option: str) -> None:
        self.page.get_by_label(label, exact=True).first.click()
        self.page.get_by_role("option", name=option, exact=True).click()

    def height(self) -> float:
        return float(self.behind._scene.platform_position[2])

    def time(self) -> float:
        return float(self.behind.live.scenario().result().duration)

    def picture(self) -> np.ndarray:
        box = self.page.locator("canvas").first.bounding_box()
        assert box is not None
        middle = {
            "x": box["x"] + 0.3 * box["width"],
            "y": box["y"],
            "width": 0.4 * box["width"],
            "height": 0.6 * box["height"],
        }
        return matplotlib.image.imread(io.BytesIO(self.page.screenshot(clip=middle)))

    def close(self) -> None:
        self.page.close()


@pytest.fixture(scope="module")
def opened(browser: Browser, studio: Studio) -> Iterator[Tab]:
    tab = Tab(browser, studio)
    yield tab
    tab.close()


@pytest.fixture
def tab(opened: Tab) -> Iterator[Tab]:
    """The tab, at the beginning of the first scenario."""
    scenario = desk.ready_scenarios()["studio"]

    def begun() -> bool:
        present = opened.behind.live.scenario().result()
        same = (present.cab, present.law) == (scenario.cab, scenario.law)
        return same and not present.change

    if not begun():
        opened.behind.desk.begin(scenario)
        opened.wait(begun)

    def goes_on() -> bool:  # a click on a page that is being filled anew may be lost
        opened.press("go on")
        return not opened.behind.live.paused

    opened.wait(goes_on)
    yield opened
    assert opened.errors == []  # nothing was said on the console


@pytest.fixture
def fewer_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Spares the cores where a test is not about real time: WebGL in software takes them all."""
    monkeypatch.setattr(live, "TURN", 0.1)


def _changed(one: np.ndarray, other: np.ndarray) -> float:
    """Share of the pixels that differ."""
    return float(np.mean(np.abs(one - other).max(axis=-1) > 0.1))


def _error(behind: StudioPage) -> float:
    """Root mean square of demand less response over the last two seconds: four cycles."""
    record = behind.live.record().result()
    rows = record.time > record.time[-1] - 2.0
    error = (record["demand_pose"] - record["platform_pose"])[rows, 2]
    return float(np.sqrt(np.mean(error**2)))


def test_page_moves_the_platform_in_real_time_with_its_plots_on(tab: Tab) -> None:
    tab.press("pause")
    tab.wait(lambda: _changed(tab.picture(), tab.picture()) == 0.0)  # nothing else moves
    first, before = tab.picture(), tab.height()
    assert first[..., :3].std() > 0.05  # something is drawn at all
    tab.press("go on")
    tab.wait(lambda: abs(tab.height() - before) > 0.02)
    tab.wait(lambda: _changed(tab.picture(), first) > 0.002)

    def keeps_up() -> bool:
        said = tab.status(r"real-time factor [\d.]+")
        match = re.search(r"real-time factor ([\d.]+), paced to ([\d.]+)", said)
        assert match is not None
        return float(match[1]) >= 1.0 and 0.97 <= float(match[2]) <= 1.03

    tab.wait(keeps_up)
    assert tab.page.get_by_text("leg forces [lbf]").is_visible()
    assert tab.page.locator(".uplot canvas").count() >= 5


@pytest.mark.usefixtures("fewer_pictures")
def test_law_chosen_on_the_page_changes_the_response(tab: Tab) -> None:
    tab.wait(lambda: tab.time() > 4.0)
    velocity = _error(tab.behind)
    tab.choose("law", "position_error_rate")
    tab.status("law position_error_rate")
    since = tab.time()
    tab.wait(lambda: tab.time() > since + 4.0)
    assert _error(tab.behind) < 0.9 * velocity  # -90 deg at 3.6 Hz instead of 2.7
    assert tab.behind.live.scenario().result().change[0].law == "position_error_rate"


@pytest.mark.usefixtures("fewer_pictures")
def test_a_setting_acts_and_a_bad_one_is_named_on_the_page_and_the_run_goes_on(tab: Tab) -> None:
    tab.choose("signal", "noise")
    tab.wait(lambda: len(tab.behind.live.scenario().result().change) == 1)
    field = tab.page.get_by_label("stop [Hz]", exact=True).first
    field.fill("0.8")
    tab.wait(lambda: len(tab.behind.live.scenario().result().change) == 2)
    (signal,) = tab.behind.live.scenario().result().change[1].signal or ()
    assert signal.kind == "noise" and signal.band == (0.05, 0.8)
    field.fill("-1")
    assert "noise.stop: -1.0 is refused" in tab.status("noise.stop")
    since = tab.time()
    tab.wait(lambda: tab.time() > since + 0.5)


@pytest.mark.usefixtures("fewer_pictures")
def test_a_refused_amplitude_is_not_sent_when_its_field_is_left(tab: Tab) -> None:
    beside = "xpath=following::input[not(@type='hidden')][1]"
    field = tab.page.get_by_text("amplitude [in]", exact=True).locator(beside).last
    field.fill("2000")
    field.press("Enter")
    tab.status("amplitude .*2000 is refused")
    tab.wait(lambda: field.input_value() == "2")
    field.press("Tab")
    since = tab.time()
    tab.wait(lambda: tab.time() > since + 2.0)
    assert tab.behind.live.scenario().result().change == ()


@pytest.mark.usefixtures("fewer_pictures")
def test_two_tabs_do_not_disturb_one_another(tab: Tab, browser: Browser, studio: Studio) -> None:
    other = Tab(browser, studio)
    other.choose("law", "force")
    other.status("law force")
    other.press("pause")
    other.status("paused")
    stopped, since = other.time(), tab.time()
    tab.wait(lambda: tab.time() > since + 1.0)
    assert other.time() == stopped
    tab.status("law velocity")
    other.close()
    tab.wait(lambda: not other.behind.live._thread.is_alive())  # closing the tab ends its thread
    assert other.errors == []
    since = tab.time()
    tab.wait(lambda: tab.time() > since + 0.5)
    tab.wait(lambda: studio.pages == (tab.behind,))


@pytest.mark.usefixtures("fewer_pictures")
def test_exported_session_runs_again_bit_for_bit(tab: Tab, tmp_path: Path) -> None:
    tab.choose("law", "position_error_rate")
    tab.status("law position_error_rate")
    tab.choose("signal", "noise")
    tab.wait(lambda: len(tab.behind.live.scenario().result().change) == 2)
    tab.page.get_by_label("push now", exact=True).first.click()
    tab.wait(lambda: len(tab.behind.live.scenario().result().change) == 3)
    since = tab.time()
    tab.wait(lambda: tab.time() > since + 1.0)
    tab.press("pause")
    tab.status("paused")
    with tab.page.expect_download() as download:
        tab.press("export scenario")
    path = tmp_path / "session.toml"
    download.value.save_as(path)
    with tab.page.expect_download() as download:
        tab.press("save page")
    download.value.save_as(tmp_path / "session.html")
    title = re.search(r"<title>(.*)</title>", (tmp_path / "session.html").read_text("utf-8"))
    assert title is not None
    assert re.fullmatch(r"velocity, [\d.]+ s: law position_error_rate, [\d.]+ s: push", title[1])
    record = tab.behind.live.record().result()
    again = load_scenario(path).record()
    assert again.time.size == record.time.size > 128
    for name, values in record.channels.items():
        assert np.array_equal(again[name], values), name


@pytest.mark.usefixtures("fewer_pictures")
def test_units_change_what_is_shown_and_not_the_demand(tab: Tab) -> None:
    """An amplitude of 2 in is 50.8 mm; the signal stays as it was."""
    begun = tab.behind.live.scenario().result()
    tab.choose("units", "metric")
    for title in ("amplitude [mm]", "platform, heave [mm]", "manifolds [bar]"):
        tab.page.get_by_text(title).first.wait_for()
    beside = "xpath=following::input[not(@type='hidden')][1]"  # viser gives it no label
    assert tab.page.get_by_text("amplitude [mm]").locator(beside).input_value() == "50.8"
    assert tab.behind.live.scenario().result().change == begun.change == ()


@pytest.mark.usefixtures("fewer_pictures")
def test_a_drive_goes_through_a_washout_that_is_exchanged_as_it_goes(
    tab: Tab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(controls, "CUED", tmp_path)

    def sent() -> list[str]:
        changes = tab.behind.live.scenario().result().change
        return [Path(getattr(one.signal[0], "file", "")).name for one in changes if one.signal]

    tab.choose("flight", "slalom")
    tab.wait(lambda: sent() == ["slalom-simona-cmf-gfd.csv"])
    tab.choose("washout", "optimal")
    tab.wait(lambda: len(sent()) == 2)
    begun = tab.time()
    tab.wait(lambda: tab.time() > begun + 8.0)
    for said in ("host frames slalom, optimal", "platform, sway"):
        tab.page.get_by_text(said).first.wait_for()
    cued = cue(load_flight("slalom").motion, "optimal").stream
    files = [read_stream(tmp_path / name) for name in sent()]
    np.testing.assert_array_equal(files[1].values, cued.values)
    assert np.abs(files[0].values - cued.values).max() > 0.01
    assert abs(float(tab.behind._scene.platform_position[1])) > 0.01
    tab.choose("signal", "step")  # takes over, and the page says so
    tab.page.get_by_text("signal step in heave").first.wait_for()
    tab.page.get_by_text("platform, heave").first.wait_for()
    tab.choose("flight", "slalom")  # flies again
    tab.wait(lambda: sent()[-1] == "slalom-optimal-cmf-gfd.csv" and len(sent()) == 4)
    tab.choose("flight", "none")
    tab.wait(lambda: tab.behind.live.scenario().result().change[-1].signal == ())


def test_another_cab_can_be_chosen_and_reset(tab: Tab) -> None:
    tab.choose("law", "velocity_integral")
    tab.status("law velocity_integral")
    tab.choose("cab", "ifd")
    tab.wait(lambda: tab.behind._scene.cab.name == "ifd")
    tab.wait(lambda: tab.time() > 1.5)
    tab.press("reset")
    tab.wait(lambda: tab.time() < 1.5)
    assert tab.behind.live.scenario().result().cab == "ifd"


@pytest.mark.usefixtures("fewer_pictures")
def test_page_offers_every_law_and_failure(tab: Tab) -> None:
    for label, options in (("law", law_names("all")), ("failure", KINDS)):
        tab.page.get_by_label(label, exact=True).first.click()
        for option in options:
            assert tab.page.get_by_role("option", name=option, exact=True).count() == 1, option
        tab.page.keyboard.press("Escape")
    tab.choose("failure", "valve_hard_over")
    tab.press("fail now")
    tab.wait(lambda: len(tab.behind.live.scenario().result().change) == 1)
    (change,) = tab.behind.live.scenario().result().change
    assert change.failure[0].kind == "valve_hard_over" and change.failure[0].leg == 1


@pytest.mark.usefixtures("fewer_pictures")
def test_a_lesson_answers_what_was_done_and_leads_to_the_next(tab: Tab) -> None:
    tab.page.get_by_label("scenario", exact=True).first.click()
    tab.page.get_by_role("option", name="Surge step, position error rate feedback").click()
    tab.status("Lesson, 1 of 4")
    tab.wait(lambda: tab.behind.live.paused)  # until the prompt is read
    assert tab.page.get_by_text("twice the step").count() == 0 and tab.time() < 0.01
    tab.press("go on")
    tab.page.get_by_text("twice the step").wait_for()
    tab.press("next prompt")
    tab.status("Lesson, 2 of 4")
    tab.choose("law", "modal_plan")  # not what is asked for
    since = tab.time()
    tab.wait(lambda: tab.time() > since + 4.0)
    onward = tab.page.get_by_role("button", name="next prompt")
    assert onward.count() == 0
    tab.choose("law", "velocity")
    onward.wait_for()
    tab.press("reset")  # a new run has no such event, but the prompt was answered
    tab.wait(lambda: tab.time() < since)
    tab.status("Lesson, 2 of 4")
    assert onward.count() == 1


_REACHED = """() => [
    ...document.querySelectorAll("button, input:not([type=hidden]), [role=slider]")
].filter(one => one.checkVisibility()).map(one => {
    one.scrollIntoView({block: "center", behavior: "instant"});
    const {left, top, right, bottom} = one.getBoundingClientRect();
    const there = document.elementFromPoint((left + right) / 2, (top + bottom) / 2);
    const inside = left >= 0 && top >= 0 && right <= innerWidth && bottom <= innerHeight;
    return [one.outerHTML, inside && one.parentElement.contains(there)];
})"""
"""All controls that are there, and whether each can be brought into the window with none above."""


@pytest.mark.usefixtures("fewer_pictures")
def test_every_control_is_reached_in_a_small_window(tab: Tab) -> None:
    size = tab.page.viewport_size
    assert size is not None
    tab.page.set_viewport_size({"width": 1280, "height": 720})
    found = tab.page.evaluate(_REACHED)
    tab.page.set_viewport_size(size)
    handles = tab.behind.desk.client.gui._gui_input_handle_from_uuid.values()
    assert len(found) >= sum(handle.visible for handle in handles) > 25
    assert [text for text, reached in found if not reached] == []


_CALLS = """address => new Promise(done => {
    const socket = new WebSocket(address, ["viser-v" + "%s"]);
    socket.onopen = () => done("open");
    socket.onerror = () => done("refused");
})"""
"""What a page does that wants a session."""


def test_a_page_of_another_site_gets_no_session_and_a_wrong_token_no_page(
    browser: Browser,
) -> None:
    calls = _CALLS % viser.__version__
    guarded = Studio("0.0.0.0", port=8465)
    try:
        address, _, _ = guarded.url.partition("/?")
        page = browser.new_page()
        page.set_default_timeout(PATIENCE)
        page.route("http://evil.test/**", lambda route: route.fulfill(body="<html>hello</html>"))
        page.goto(f"{address}/?token=guess")
        assert "token: is missing or wrong" in page.inner_text("body")
        assert page.evaluate(calls, address.replace("http", "ws")) == "refused"
        page.goto(guarded.url)  # and the browser has the cookie from now on
        page.get_by_text("real-time factor").wait_for()
        assert page.evaluate(calls, address.replace("http", "ws")) == "open"
        page.goto("http://evil.test/")
        assert page.evaluate(calls, address.replace("http", "ws")) == "refused"
        page.close()
    finally:
        guarded.stop()
