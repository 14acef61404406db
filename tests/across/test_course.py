"""The course: its closed form, its page in Chromium against it, its notebooks as they run."""

import json
import re
import runpy
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import control
import matplotlib
import numpy as np
import pytest
from playwright.sync_api import Browser
from shared import data_rows, rows_of

from cmf_mj import Hexapod, load_machine

ROOT = Path(__file__).resolve().parents[2]
COURSE = ROOT / "docs" / "_static" / "course"
NOTEBOOKS = sorted(COURSE.glob("*.ipynb"))


@pytest.fixture(scope="module")
def hand() -> SimpleNamespace:
    return SimpleNamespace(**runpy.run_path(str(COURSE / "by_hand.py")))


@pytest.fixture(scope="module")
def script() -> SimpleNamespace:
    return SimpleNamespace(**runpy.run_path(str(ROOT / "scripts" / "course.py")))


@pytest.mark.parametrize("mass", [2000.0, 3485.7, 17846.9, 25000.0])
def test_the_closed_form_is_that_of_the_loop_of_its_parts(
    hand: SimpleNamespace, mass: float
) -> None:
    """Spring, mass, leak, lag and law joined by python-control, not by hand."""
    of = hand.given()
    s = control.tf("s")
    stiffness, damper = of.stiffness, of.rate / of.stiffness
    # The valve moves the far end y of the spring, whose force also leaks oil: dy/dt = v - damper F.
    force = mass * s**2
    rest = s * (1 + force / stiffness) + damper * force
    drive = of.speed / (1 + of.tau * s)
    law = of.gain + (of.acceleration + of.load * mass) * s**2
    closed = control.feedback(drive / rest, law) * of.gain
    w = 2.0 * np.pi * np.geomspace(0.1, 15.0, 50)
    a = hand.polynomial(mass, of)
    assert np.allclose(closed(1j * w), a[-1] / np.polyval(a, 1j * w), rtol=1e-9)
    found = hand.leg(mass, of)
    assert np.angle(closed(2j * np.pi * found["lag90"]), deg=True) == pytest.approx(-90.0)
    loop = control.minreal(
        control.tf([of.speed * of.gain], np.polysub(a, [of.speed * of.gain])), verbose=False
    )
    assert 20.0 * np.log10(control.margin(loop)[0]) == pytest.approx(found["margin"], abs=1e-6)
    swings = [pole for pole in control.poles(closed) if pole.imag > 1e-6]
    assert min(map(abs, swings)) * np.sqrt(1.0 - found["damping"] ** 2) == pytest.approx(
        2.0 * np.pi * found["swing"]
    )
    time = np.linspace(0.0, 3.0, 50)
    _, response = control.step_response(control.tf([a[-1]], a), time)
    assert hand.step(mass, time, of) == pytest.approx(response, abs=1e-6)


def test_the_numbers_of_the_lesson_are_made_from_the_models(script: SimpleNamespace) -> None:
    made = {"legs": script.legs(COURSE), "leg_values": script.values(), "leg_mass": script.masses()}
    made |= {"leg_gains": script.gains(), "leg_fit": script.fit()}
    for name, text in made.items():
        assert text == (ROOT / f"docs/data/{name}.csv").read_text(encoding="utf-8"), name


def test_the_mass_by_hand_is_that_of_the_models_gimbals(hand: SimpleNamespace) -> None:
    """Stretches from positions of the gimbals and a small motion, not from the Jacobian."""
    row, *_ = data_rows("leg_mass")
    stated = {one["symbol"]: float(one["value"]) for one in data_rows("leg_values")}
    gimbals = load_machine("cmf").gimbals
    upper, lower = (np.array(one.value) for one in (gimbals.upper, gimbals.lower))
    length = np.linalg.norm(upper - lower, axis=1)
    lean = np.degrees(np.arccos((upper - lower)[:, 2] / length))
    assert lean == pytest.approx(np.full(6, stated["θ"]), abs=0.01)
    for axis, name in ((0, "surge"), (2, "heave")):
        moved = np.linalg.norm(upper - lower + 1e-6 * np.eye(3)[axis], axis=1)
        stretch = (moved - length) / 1e-6
        pounds = stated["M"] / (stretch @ stretch)
        assert float(row[f"{name} [lbm]"]) == pytest.approx(pounds, abs=1.0)
    assert hand.payload() / 0.45359237 == pytest.approx(stated["M"], abs=0.5)


@pytest.mark.parametrize("name", ["surge", "heave"])
def test_each_column_of_the_time_series_is_in_the_data_dictionary(name: str) -> None:
    rows = rows_of(COURSE / f"step_{name}.csv")
    said = json.loads((COURSE / f"step_{name}.csv-metadata.json").read_text(encoding="utf-8"))
    time, moved = ([float(row[n]) for row in rows] for n in ("time_s", "response_m"))
    assert [column["name"] for column in said["tableSchema"]["columns"]] == list(rows[0])
    assert said["url"] == f"step_{name}.csv" and len(rows) == 512
    assert np.allclose(np.diff(time), 1 / 128)
    assert max(moved) > 0.0254  # it overshoots an inch


def test_the_pages_have_the_exercises_of_the_notebooks_and_the_step_of_the_series(
    script: SimpleNamespace, hand: SimpleNamespace, tmp_path: Path
) -> None:
    script.pages(tmp_path)
    for name in ("exercises", "leg"):
        kept = (COURSE / f"{name}.html").read_text(encoding="utf-8")
        assert (tmp_path / f"{name}.html").read_text(encoding="utf-8") == kept
    line = script.exercises()
    rows = json.loads(line[line.index("[") : -1])
    assert [row["number"] for row in rows] == list(range(1, 13))
    assert all("?" in row["question"] and row["hint"] for row in rows)
    assert [row["number"] for row in rows if row["answer"]] == [3, 6, 9, 11]


# The pages


@pytest.mark.slow
def test_the_exercises_mark_themselves(hand: SimpleNamespace, browser: Browser) -> None:
    page = browser.new_context(offline=True).new_page()
    for lesson, numbers in ((1, range(1, 7)), (2, range(7, 10)), (3, range(10, 13))):
        page.goto("about:blank")
        page.goto((COURSE / "exercises.html").as_uri() + f"#{lesson}")
        parts = page.locator("section")
        assert parts.count() == len(numbers)
        for part, number in zip(parts.all(), numbers, strict=True):
            true, unit, hint = hand.right()[number]
            within = hand.WITHIN.get(number, 0.02)
            for off in (-1.5, -0.75, 0.75, 1.5):
                factor, good = 1.0 + off * within, abs(off) < 1.0
                part.get_by_role("textbox").fill(f"{factor * true:.6g}")
                part.get_by_role("button", name="mark").click()
                said = part.locator("p").last.inner_text()
                assert said.startswith("Right") == good and (good or hint in said)
            for written in (f"{true:,.2f}", f" {true:.2f} ") if true > 1000.0 else ():
                part.get_by_role("textbox").fill(written)
                part.get_by_role("button", name="mark").click()
                assert part.locator("p").last.inner_text().startswith("Right")
            part.get_by_role("button", name="answer").click()
            assert unit in part.locator("p").last.inner_text()


@pytest.mark.slow
@pytest.mark.parametrize("size", [(1280, 720), (390, 844)], ids=["wide", "phone"])
def test_the_page_computes_what_python_does(
    hand: SimpleNamespace, browser: Browser, size: tuple[int, int]
) -> None:
    of = hand.given()
    draws = np.random.default_rng(0)
    viewport: Any = dict(zip(("width", "height"), size, strict=True))
    page = browser.new_context(offline=True, viewport=viewport).new_page()
    complaints: list[str] = []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto((COURSE / "leg.html").as_uri())
    fixed = page.evaluate("FIXED")
    assert [fixed[name] for name in ("tau", "rate", "load")] == pytest.approx(list(of[4:]))
    begun = page.evaluate("values()")
    modes = Hexapod("gfd").hydraulic_modes().leg_mass
    names = ("stiffness", "speed", "gain", "acceleration")
    assert [begun[name] for name in names] == pytest.approx(list(of[:4]), rel=1e-6)
    masses = page.locator("button").evaluate_all("all => all.map(b => +b.dataset.mass)")
    assert masses == pytest.approx([modes[3], modes[0]], rel=1e-6)
    assert begun["mass"] == masses[0]
    ranges = page.evaluate("SLIDERS")
    for _ in range(40):
        drawn = {name: float(draws.uniform(*one[2:4])) for name, one in ranges.items()}
        now = of._replace(**{name: drawn[name] for name in names})
        mine = hand.leg(drawn["mass"], now)
        js = "v => { const r = leg(v); return [r, step(r, 0.31)]; }"
        theirs, stepped = page.evaluate(js, drawn)
        a = hand.polynomial(drawn["mass"], now)
        for name, value in mine.items():
            assert theirs[name] == pytest.approx(value, rel=1e-9, abs=1e-9), name
        system = control.tf([a[-1]], a)
        _, expected = control.step_response(system, [0.0, 0.155, 0.31])
        assert stepped == pytest.approx(expected[-1], rel=1e-9, abs=1e-9)
    recorded, of = hand.series("surge"), hand.given()
    for mass in (hand.fitted(), 15000.0):
        apart = page.evaluate("m => apart(leg({...values(), mass: m}))", mass)
        left = np.sqrt(np.mean(hand.misfit(mass, of, *recorded) ** 2))
        assert apart == pytest.approx(left, rel=2e-3)
    page.get_by_text("the leg in surge").click()
    peak = (ROOT / "docs/data/legs.csv").read_text(encoding="utf-8").splitlines()[2].split(",")
    shown = page.locator("#results").inner_text()
    assert f"{peak[5]} dB" in shown and f"{peak[6]} Hz" in shown
    gain = page.get_by_role("slider", name="gain on its position")
    gain.fill("5")  # the answer to exercise 6: the swing is the oil's
    assert page.evaluate("leg(values()).swing") == pytest.approx(float(peak[3]), abs=0.05)
    page.get_by_role("button", name="the leg in heave").click()
    assert page.evaluate("values()") == begun
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert complaints == []


# The notebooks


BESIDE = ("by_hand.py", "step_surge.csv")


def ran(
    path: Path, monkeypatch: pytest.MonkeyPatch, folder: Path, beside: tuple[str, ...] = BESIDE
) -> dict[str, Any]:
    """Names of a notebook in a folder with these files, after all cells but that which installs."""
    for name in beside:
        shutil.copy(COURSE / name, folder)
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(folder)
    monkeypatch.delitem(sys.modules, "by_hand", raising=False)
    matplotlib.use("Agg")
    cells = [c for c in json.loads(path.read_text(encoding="utf-8"))["cells"] if "outputs" in c]
    assert "%pip install" in "".join(cells[0]["source"])
    names: dict[str, Any] = {}
    for cell in cells[1:]:
        exec("".join(cell["source"]), names)  # noqa: S102
    names["plt"].close("all")
    return names


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_marks(
    path: Path,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    names = ran(path, monkeypatch, tmp_path)
    count = {"why_surge_shakes": 6}.get(path.stem, 3)
    said = capsys.readouterr().out
    assert said.count("not answered yet") == said.count(": right: ") == count
    for number, answer in names["answers"].items():
        off = 1.5 * names["mark"].__globals__["WITHIN"].get(number, 0.02)
        for wrong in ((1.0 + off) * answer, (1.0 - off) * answer):
            names["mark"](number, wrong)
    said = capsys.readouterr().out
    assert "right" not in said
    assert len(re.findall("Hz|kg|MN/m|%|s\\.", said)) >= 2 * count


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_opened_alone_says_what_it_needs(
    path: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with pytest.raises(FileNotFoundError, match="by_hand.py and step_surge.csv: put beside"):
        ran(path, monkeypatch, tmp_path, ())
    first = json.loads(path.read_text(encoding="utf-8"))["cells"][0]["source"]
    assert all(f"[{name}]({name})" in "".join(first) for name in BESIDE)


def test_the_curvature_promises_more_than_the_fitted_mass_keeps(hand: SimpleNamespace) -> None:
    """Least squares: sd of the mass is that of what is left over the norm of its derivative."""
    of, recorded, mass = hand.given(), hand.series("surge"), hand.fitted()
    left = hand.misfit(mass, of, *recorded)
    more, less = (hand.misfit(change * mass, of, *recorded) for change in (1.001, 0.999))
    slope = (more - less) / (0.002 * mass)
    promised = left.std() / np.sqrt(np.sum(slope**2)) / mass
    assert promised < 0.01 < 0.15 < abs(mass / hand.surge() - 1.0)
