"""Runs as a page: it holds the record, and what Chromium draws of it is MuJoCo's picture."""

import base64
import copy
import io
import json
import re
from collections.abc import Iterator
from pathlib import Path
from time import monotonic
from typing import Any

import matplotlib.image
import mujoco
import numpy as np
import pytest
from playwright.sync_api import Browser, Page
from shared import cmf

from cmf_mj import Hexapod, Record, Run
from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.facility.scenario import save_scenario, scenario_of
from cmf_mj.facility.signal import ValveCommands
from cmf_mj.machine.geometry import DOFS, dof_unit
from cmf_mj.plant.hexapod import hexapod_model, hexapod_spec
from cmf_mj.show.look import Curve, Panel
from cmf_mj.show.player import page as writer
from cmf_mj.show.player.page import PlayedRun
from cmf_mj.show.player.play import play
from cmf_mj.show.player.traces import busiest_leg, limits_of, traces_of

ROOT = Path(__file__).resolve().parents[2]
LAWS = "velocity", "position_error_rate"
SIZES = (1280, 720), (390, 844)


@pytest.fixture(scope="module")
def records() -> list[Record]:
    """Two laws that follow a step up with sines, so that all joints move."""
    sines = [
        {"kind": "sine", "dof": dof, "amplitude": [6.0, unit], "frequency": 1.0}
        for dof, unit in (("yaw", "deg"), ("surge", "in"))
    ]
    step = {"kind": "step", "dof": "heave", "amplitude": [-12.0, "in"], "at": 0.1}
    table = {"duration": 1.5, "signal": [step, *sines]}
    return [scenario_of({**table, "law": law}, "test").record() for law in LAWS]


@pytest.fixture(scope="module")
def path(records: list[Record], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return play(records, tmp_path_factory.mktemp("page") / "two.html")


def content(path: Path) -> dict[str, Any]:
    text = path.read_text(encoding="utf-8")
    found = re.search(r'<script id="data" type="application/json">(.*?)</script>', text, re.S)
    assert found is not None
    return json.loads(found[1])


def row_at(record: Record, time: float) -> int:
    return int(np.searchsorted(record.time, time + 1e-9, side="right")) - 1


def test_a_page_holds_the_records_own_states(records: list[Record], path: Path) -> None:
    held = content(path)
    for record, run in zip(records, held["runs"], strict=True):
        qpos = np.frombuffer(base64.b64decode(run["qpos"]), "<f4").reshape(held["count"], -1)
        times = held["start"] + np.arange(held["count"]) / held["rate"]
        rows = [row_at(record, time) for time in times]
        assert np.array_equal(qpos, record["generalised_position"][rows].astype(np.float32))
        assert times[-1] == pytest.approx(record.time[-1], abs=1 / 30)
    assert path.stat().st_size < writer.MOST_BYTES
    assert len({run["panels"][1]["title"] for run in held["runs"]}) == 1  # the same leg


def test_a_page_asks_for_nothing_and_names_whose_its_library_is(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert set(re.findall(r"https?://[^\s\"'`)]*", text)) == {
        "http://www.w3.org/1999/xhtml",
        "http://www.w3.org/2000/svg",
    }
    assert "Permission is hereby granted" in text and "three.js authors" in text
    assert "default-src 'none'" in text and "{{" not in text.split("<script>")[0]


def test_slow_motion_that_asks_for_too_much_has_fewer_samples(
    records: list[Record], tmp_path: Path
) -> None:
    path = play(records, tmp_path / "slow.html", speed=1e-4)
    assert 2_500_000 < path.stat().st_size < writer.MOST_BYTES
    assert content(path)["rate"] < writer.SAMPLES_A_SECOND / 1e-4


def test_a_model_too_large_for_a_page_is_refused(
    records: list[Record], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer, "MOST_BYTES", 500_000)
    with pytest.raises(InputError, match=r"file: x.html with 0\.\d MB must be at most 0\.5 MB"):
        play(records, tmp_path / "x.html")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "shown", sorted((ROOT / "docs/_static/films").glob("*.html")), ids=lambda p: p.stem
)
def test_the_sites_pages_are_what_the_command_writes_today(shown: Path, path: Path) -> None:
    """But for their runs: title, words and data."""
    runs = re.compile(
        r"<title>.*?</title>|</summary>.*?</details>|application/json\">.*?</script>", re.S
    )
    written, today = (runs.sub("", one.read_text(encoding="utf-8")) for one in (shown, path))
    assert written == today
    assert shown.stat().st_size < writer.MOST_BYTES


def test_a_step_is_said_in_words(tmp_path: Path) -> None:
    """Of a swing in closed form: 3 Hz, each half of the last, twice the step at first."""
    time = np.linspace(0.0, 5.0, 5001)
    late = np.maximum(time - 0.5, 0.0)
    swing = 1.0 - 0.5 ** (3.0 * late) * np.cos(6.0 * np.pi * late)
    curves = (
        Curve("demand", time, np.where(time < 0.5, 0.0, -2.0), "k"),
        Curve("response", time, np.where(time < 0.5, 0.0, -2.0 * swing), "k"),
    )
    panel = Panel("surge [in]", curves)
    model = hexapod_model("gfd")
    qpos = np.tile(mujoco.MjData(model).qpos, (time.size, 1))
    runs = [PlayedRun(model, time, qpos, "a step", [panel])]
    text = writer.write_page(runs, (0.0, 5.0), tmp_path / "x.html", 1.0, "overview").read_text(
        encoding="utf-8"
    )
    top = swing.max()
    assert (
        f"response goes to {top:.2f} of the step, ends at 1.00, swings 3.0 times a second" in text
    )
    assert "each swing 50% of the last" in text
    assert f"<td>{-2 * top:.2f} at 0.66 s</td><td>0.00 at 0.00 s</td>" in text
    pulse = curves[0]._replace(y=np.where(np.abs(time - 1.0) < 0.5, 1.0, 0.0))
    assert writer._step_text(panel._replace(curves=(pulse, curves[1])), (0.0, 5.0)) == ""
    between = writer._summary(runs, (1.0002, 1.0004))
    assert "<td>-2.000</td><td>-2.000 at 1.00 s</td>" in between


@pytest.fixture(scope="module")
def opened() -> Record:
    valves = ValveCommands(np.tile([0.1, 0.1, -0.05, -0.05, -0.05, -0.05], (64, 1)))
    return Run(plant=Hexapod(), law=None, source=valves, electronics=None).record()


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"path": "x.mp4"}, "file: x.mp4 must end in .html"),
        ({"camera": "roof"}, "camera: 'roof' is not one of overview, side"),
        ({"speed": 0.0}, "speed: 0.0 must be greater than 0"),
        ({"start": 1.5}, "start: 1.5 s; allowed: from 0 to below 1.49"),
        ({"seconds": 0.0}, "seconds: 0.0 must be greater than 0"),
        ({"records": []}, "records: none is given"),
    ],
)
def test_what_a_page_cannot_do_is_named(
    change: dict[str, Any], text: str, records: list[Record], tmp_path: Path
) -> None:
    arguments = {"records": records, "path": "x.html"} | change
    with pytest.raises(InputError) as refused:
        play(arguments.pop("records"), tmp_path / arguments.pop("path"), **arguments)
    assert text in str(refused.value)
    assert not list(tmp_path.iterdir())


def test_a_part_of_a_run_is_its_rows(records: list[Record], tmp_path: Path) -> None:
    part = content(play(records, tmp_path / "part.html", start=0.2, seconds=0.2))
    assert part["start"] == 0.2 and (part["count"] - 1) / part["rate"] == pytest.approx(0.2)
    qpos = np.frombuffer(base64.b64decode(part["runs"][0]["qpos"]), "<f4")
    first = records[0]["generalised_position"][row_at(records[0], 0.2)]
    np.testing.assert_array_equal(qpos[: first.size], first.astype(np.float32))


def test_traces_are_the_records(records: list[Record]) -> None:
    motion, pressures = traces_of(records[0])
    assert motion.y_title == "heave [in]"
    response = {curve.name: curve.y for curve in motion.curves}["response"]
    np.testing.assert_array_equal(response, records[0]["platform_pose"][:, 2] / units.INCH)
    leg = int(pressures.y_title.split()[1])
    cap = pressures.curves[0]
    assert cap.name == "cap"
    np.testing.assert_array_equal(cap.y, records[0]["cap_pressure"][:, leg - 1] / units.PSI)


def test_runs_beside_each_other_show_one_leg(records: list[Record]) -> None:
    """The one that moves most in any of them, here the other leg of the second."""
    record, leg = records[0], busiest_leg(records[0])
    pressures = record["cap_pressure"].copy()
    pressures[:, (leg + 1) % 6] = 2.0 * pressures[:, leg]
    other = {"cap_pressure": pressures}
    assert busiest_leg(record, other) == (leg + 1) % 6 == busiest_leg(other, record)
    _, shown = traces_of(record, leg=(leg + 1) % 6)
    assert shown.y_title == f"leg {(leg + 1) % 6 + 1} [psi]"


def test_an_open_loop_shows_its_response(
    opened: Record, records: list[Record], tmp_path: Path
) -> None:
    motion, _ = traces_of(opened)
    (response,) = motion.curves
    column = DOFS.index(motion.y_title.split()[0])
    scale = units.factor(dof_unit(column))
    np.testing.assert_array_equal(response.y, opened["platform_pose"][:, column] / scale)
    with pytest.raises(InputError, match=r"traces: \[0, 2\] panels; allowed: as many"):
        play([records[0], opened], tmp_path / "x.html", traces=[(), traces_of(opened)])


def test_limits_hold_what_is_drawn() -> None:
    """Also of no pressure, and of a span between two samples, where lines are drawn."""
    time = np.linspace(0.0, 1.0, 11)
    still = Panel("cap [psi]", (Curve("cap", time, 0.0 * time, "k"),), from_zero=True)
    sinking = Panel("cap [psi]", (Curve("cap", time, time - 3.0, "k"),), from_zero=True)
    rising = Panel("heave [in]", (Curve("response", time, time, "k"),))
    for panel, span, least, most in (
        *((still, (0.0, 1.0), 0.0, 0.0), (sinking, (0.0, 1.0), -3.0, 0.0)),
        (rising, (0.42, 0.44), 0.42, 0.44),
    ):
        low, high = limits_of([panel], span)
        assert low <= least and most <= high and low < high


def test_the_command_takes_the_folder_of_a_run_and_compares_laws(
    records: list[Record], tmp_path: Path
) -> None:
    records[0].save(tmp_path / "run" / "record.parquet")
    out = tmp_path / "run.html"
    cmf("play", tmp_path / "run", "--file", out)
    assert "<title>run: velocity</title>" in out.read_text(encoding="utf-8")
    sine = {"kind": "sine", "dof": "heave", "amplitude": [6.0, "in"], "frequency": 1.0}
    short = scenario_of({"duration": 0.2, "signal": [sine]}, "test")
    path = save_scenario(short, tmp_path / "short.toml")
    cmf("play", path, "--laws", "velocity,original", "--file", out)
    assert [run["title"] for run in content(out)["runs"]] == ["velocity law", "original law"]


@pytest.mark.parametrize("cab", ["gfd", "rfd", "ifd"])
def test_looks_do_not_act(cab: str) -> None:
    """The machine without a single shape, light, camera or picture moves bit for bit the same."""
    full, bare = hexapod_spec(cab), hexapod_spec(cab)
    for kind in (bare.geoms, bare.lights, bare.cameras):
        for element in list(kind):
            bare.delete(element)
    states = []
    for spec in (full, bare):
        model = spec.compile()
        data = mujoco.MjData(model)
        rng = np.random.default_rng(5)
        for _ in range(40):
            data.ctrl[:] = 3.2e4 + rng.uniform(-2e4, 2e4, 6)
            mujoco.mj_step(model, data)
        states.append((model.nq, model.body_inertia, model.body_mass, data.qpos, data.sensordata))
    assert full.compile().ngeom > 100
    for one, other in zip(*states, strict=True):
        np.testing.assert_array_equal(one, other)


# In Chromium, with WebGL in software


class Visit:
    """A page with all it asked for and complained about."""

    def __init__(self, page: Page, path: Path) -> None:
        self.page, self.requests, self.complaints = page, list[str](), list[str]()
        page.on("request", lambda request: self.requests.append(request.url))
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.goto(path.as_uri())
        self.wait("window.player && player.drawn() > 0")

    def seek(self, time: float) -> None:
        # In one turn of the page: a frame asked for before must not pass for the one sought.
        drawn = self.page.evaluate(f"(player.seek({time}), player.drawn())")
        self.wait(f"player.drawn() > {drawn}")

    def wait(self, condition: str) -> None:
        """Playwright's own wait evaluates text in the page, which the page forbids."""
        until = monotonic() + 300.0
        while not self.page.evaluate(condition):
            assert monotonic() < until, condition
            self.page.wait_for_timeout(50)


@pytest.fixture(scope="module", params=SIZES, ids=["wide", "phone"])
def visit(path: Path, browser: Browser, request: pytest.FixtureRequest) -> Iterator[Visit]:
    width, height = request.param
    context = browser.new_context(offline=True, viewport={"width": width, "height": height})
    yield Visit(context.new_page(), path)
    context.close()


@pytest.mark.slow
@pytest.mark.parametrize("time", [0.0, 0.37, 1.2])
def test_bodies_are_where_mujoco_has_them_to_a_pixel(
    visit: Visit, records: list[Record], time: float
) -> None:
    """The oracle is MuJoCo's kinematics of the record's row, through a pinhole by hand."""
    visit.seek(time)
    model = hexapod_model("gfd")
    data = mujoco.MjData(model)
    for number, record in enumerate(records):
        data.qpos[:] = record["generalised_position"][row_at(record, time)]
        mujoco.mj_forward(model, data)
        size = (
            visit.page.locator("canvas")
            .nth(number)
            .evaluate("c => [c.clientWidth, c.clientHeight]")
        )
        width, height = size
        narrow = max(1.0, 1.2 * height / width)
        eye = model.camera("overview").id
        half = np.tan(np.radians(model.cam_fovy[eye]) / 2.0) * narrow
        seen = (data.xpos - data.cam_xpos[eye]) @ data.cam_xmat[eye].reshape(3, 3)
        x = width / 2 + height / 2 * seen[:, 0] / (-seen[:, 2] * half)
        y = height / 2 - height / 2 * seen[:, 1] / (-seen[:, 2] * half)
        for body in range(1, model.nbody):
            drawn = visit.page.evaluate(f"player.place({number}, {body})")
            assert drawn == pytest.approx([x[body], y[body]], abs=0.5)


def blue_box(picture: np.ndarray) -> np.ndarray:
    """Left, top and right of what is blue: the cab's band and the frame (dark below)."""
    red, green, blue = np.moveaxis(picture[:, :, :3].astype(float), 2, 0)
    y, x = np.nonzero((blue > 1.9 * red) & (blue > 1.3 * green) & (blue > 0.2))
    return np.array([x.min(), y.min(), x.max()])


@pytest.mark.slow
def test_the_picture_shows_what_mujoco_renders(visit: Visit, records: list[Record]) -> None:
    canvas = visit.page.locator("canvas").first
    width, height = (
        2 * (int(x) // 2) for x in canvas.evaluate("c => [c.clientWidth, c.clientHeight]")
    )
    boxes, lifted = [], records[0]["platform_pose"][:, 2]
    model = copy.copy(hexapod_model("gfd"))
    model.vis.global_.offwidth, model.vis.global_.offheight = 2 * width, 2 * height
    model.vis.quality.offsamples = 0  # two pixels for one each way, averaged, have sharper edges
    data = mujoco.MjData(model)
    with mujoco.Renderer(model, 2 * height, 2 * width) as renderer:
        for time in (0.0, float(records[0].time[np.abs(lifted).argmax()])):
            visit.seek(time)
            drawn = matplotlib.image.imread(io.BytesIO(canvas.screenshot()))
            row = row_at(records[0], time)
            data.qpos[:] = records[0]["generalised_position"][row]
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, "overview")
            fine = renderer.render().reshape(height, 2, width, 2, 3)
            ours = fine.mean(axis=(1, 3)) / 255.0
            boxes.append((blue_box(drawn), blue_box(ours)))
    for drawn_box, mujocos in boxes:
        assert np.abs(drawn_box - mujocos).max() <= 1.5
    assert np.abs(boxes[1][0] - boxes[0][0]).max() > 3.0


@pytest.mark.slow
def test_keys_and_the_slider_move_time_and_traces_follow(
    visit: Visit, records: list[Record]
) -> None:
    page = visit.page
    page.keyboard.press("Home")
    assert page.evaluate("player.time()") == 0.0
    page.keyboard.press("ArrowRight")
    assert page.evaluate("player.time()") == pytest.approx(1 / page.evaluate("data.rate"))
    page.keyboard.press("End")
    assert page.evaluate("player.time()") == pytest.approx(page.evaluate("end"))
    visit.seek(0.37)
    said = page.get_by_role("slider", name="Time").get_attribute("aria-valuetext")
    row, inches = row_at(records[0], 0.37), 1 / 0.0254
    assert said is not None and said.startswith("0.37 s")
    shown = [float(text) for text in page.locator(".now b").all_inner_texts()[:2]]
    names = re.search(r"(surge|heave|yaw)", page.locator(".now").first.inner_text())
    assert names is not None
    dof = ["surge", "sway", "heave", "roll", "pitch", "yaw"].index(names[1])
    unit = inches if dof < 3 else np.degrees(1.0)
    for value, channel in zip(shown, ("demand_pose", "platform_pose"), strict=True):
        assert value == pytest.approx(records[0][channel][row, dof] * unit, abs=0.02)
    page.keyboard.press(" ")
    visit.wait("player.time() > 0.4")
    page.keyboard.press(" ")
    assert page.get_by_role("button", name="Play").count() == 1


@pytest.mark.slow
def test_the_keyboard_orbits_and_motion_is_drawn_larger(visit: Visit) -> None:
    page = visit.page
    visit.seek(0.37)
    position = "camera.position.clone().sub(target).toArray()"
    begun = np.array(page.evaluate(position))
    page.locator("canvas").first.focus()
    page.keyboard.press("ArrowRight")
    turned = np.array(page.evaluate(position))
    assert turned[2] == pytest.approx(begun[2])
    assert np.arctan2(*turned[1::-1]) - np.arctan2(*begun[1::-1]) == pytest.approx(0.1)
    page.keyboard.press("ArrowUp")
    up = np.array(page.evaluate(position))
    size = np.linalg.norm(begun)
    assert np.arcsin(up[2] / size) - np.arcsin(turned[2] / size) == pytest.approx(0.1)
    page.keyboard.press("+")
    assert np.linalg.norm(page.evaluate(position)) == pytest.approx(0.9 * size)
    assert page.evaluate("player.time()") == 0.37
    true = np.array(page.evaluate("player.state(0)"))
    page.evaluate("motion = 5")
    first = np.array(page.evaluate("Array.from(runs[0].qpos.slice(0, models[0].nq))"))
    assert page.evaluate("player.state(0)") == pytest.approx(first + 5.0 * (true - first), abs=1e-6)
    page.evaluate("motion = 1")
    assert not page.locator("#swollen").is_visible()  # 12 in and more are seen as they are
    page.get_by_label("view").select_option("overview")


@pytest.mark.slow
def test_the_traces_have_times_and_round_values(visit: Visit) -> None:
    texts = visit.page.locator(".trace").nth(1).locator("text").all_text_contents()
    times = [float(text[:-2]) for text in texts if text.endswith(" s")]
    assert len(times) > 2 and np.ptp(np.diff(times)) < 1e-9
    assert visit.page.evaluate("ticks([-0.1, 2.1], 4)") == [0, 1, 2]
    assert visit.page.evaluate("ticks([-0.13, 1.66], 4)") == [0, 0.5, 1, 1.5]


@pytest.mark.slow
def test_the_page_fits_and_asks_for_nothing(visit: Visit) -> None:
    page = visit.page
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    before = page.evaluate("player.place(0, 1)")
    box = page.locator("canvas").first.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 90, box["y"] + 90)
    page.mouse.down()
    page.mouse.move(box["x"] + 150, box["y"] + 90, steps=3)
    page.mouse.up()
    assert page.evaluate("player.place(0, 14)") != before
    page.get_by_text("The runs in words").click()
    assert "lowest" in page.locator("details").inner_text()
    page.get_by_label("view").select_option("overview")
    assert [url for url in visit.requests if not url.startswith(("file:", "data:"))] == []
    assert visit.complaints == []
