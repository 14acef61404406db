"""The hydraulic crane: closed forms at rest and at the stop, other engines in between."""

import csv
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from crosscheck.crane import PUMP, History, Terms, apart, example, in_mujoco, in_scipy
from crosscheck.crane_comparison import EXUDYN, PLAIN, THROTTLED
from crosscheck.crane_exudyn import in_exudyn

from cmf_mj.core.units import FRAME

ROOT = Path(__file__).resolve().parents[2]
AREAS = np.pi / 4.0 * 0.08**2, np.pi / 4.0 * (0.08**2 - 0.035**2)
SECONDS = 7.0  # rests, rises, reaches its end stop and is pressed on it
NONE = Terms(*[False] * len(Terms._fields))


@pytest.fixture(scope="module")
def ours() -> History:
    return in_mujoco(SECONDS, 4)


@pytest.fixture(scope="module")
def second() -> History:
    """The second writing of the same equations, in our terms."""
    return in_scipy(SECONDS, NONE)


def test_at_rest_the_cylinder_holds_crane_and_two_balls() -> None:
    """The cylinder's triangle has equal sides: M g L / 2 cos + m g L cos = F (L / 2) sin 60 deg."""
    plant = example()["crane"]()
    cap, rod = plant.start().pressure[0]
    load = (500.0 + 2.0 * 100.0) * 9.8
    assert plant.static_load()[0] == pytest.approx(load, rel=1e-9)
    assert rod == pytest.approx(3.461e6, rel=1e-12)
    assert cap == pytest.approx((load + AREAS[1] * 3.461e6) / AREAS[0], rel=1e-9)
    # The benchmark prints it with four figures.
    assert cap == pytest.approx(4.163e6, abs=0.5e3)


def test_rising_steadily_equal_ports_share_as_the_squares_of_the_areas(ours: History) -> None:
    """The drops are (Q / Cv)^2, and the pistons sweep A v of oil, which is lighter in the rod's
    chamber by the difference of the pressures over 1.43 GPa."""
    row = round(5.0 / FRAME)
    lighter = 1.0 + (ours.cap[row] - ours.rod[row]) / 1.4318e9
    drops = (7.6e6 - ours.cap[row]) / (ours.rod[row] - 0.1e6)
    assert drops == pytest.approx((AREAS[0] / AREAS[1] * lighter) ** 2, rel=1e-3)


def test_on_its_stop_the_pump_presses_and_the_spring_gives(ours: History) -> None:
    """p_cap = Ps, p_rod = Pt, and x = (F - load) / k beyond 213 mm, the load swinging by 2 %."""
    angle = ours.angle[-1]
    length = np.sqrt(1.0 - np.sqrt(0.75) * np.cos(angle))
    assert ours.cap[-1] == pytest.approx(7.6e6, rel=1e-3)
    assert ours.rod[-1] == pytest.approx(0.1e6, abs=0.001 * 7.6e6)
    load = 9.8 * (250.0 + 100.0) * np.cos(angle) / (0.5 * np.sqrt(0.75) * np.sin(angle) / length)
    force = AREAS[0] * 7.6e6 - AREAS[1] * 0.1e6
    assert length - 0.713 == pytest.approx((force - load) / 1e7, rel=0.01)


def test_the_second_writing_agrees_within_a_thousandth_of_the_pump(
    ours: History, second: History
) -> None:
    pressure, early, force, angle = apart(ours, second)
    assert pressure < 3e-4 and early < 1e-5
    assert force < 10.0 and angle < 1e-6


def test_what_remains_falls_with_the_step(ours: History, second: History) -> None:
    """Of order 1: friction is that of the mean speed over the step before."""
    coarse = apart(in_mujoco(SECONDS, 1), second)[0]
    assert coarse < 1e-3
    assert coarse / apart(ours, second)[0] == pytest.approx(4.0, rel=0.1)


def test_the_comparison_would_see_a_small_mistake(second: History) -> None:
    """A tenth of a hose, or a thousandth of a port, parts the engines by more than 0.1 %."""
    parameters = example()["crane"]().parameters
    for field, factor in (("cap_dead_volume", 1.1), ("rod_port", 1.001)):
        right = getattr(parameters, field)
        wrong = in_mujoco(SECONDS, 4, **{field: (factor * right.value, right.unit)})
        assert apart(wrong, second)[0] > 1e-3, field


def test_exudyns_own_element_rises_as_chronos_equations_do(ours: History) -> None:
    """Before the stop they are the same but for what is solved how; from ours, the oil's weight."""
    seconds = 5.6
    theirs, chrono = in_exudyn(seconds), in_scipy(seconds, Terms())
    assert apart(theirs, chrono)[0] < 2e-5
    mine = History(*(values[: theirs.cap.size] for values in ours))
    assert 1e-4 < apart(mine, theirs)[0] < 6e-4


@pytest.mark.slow
def test_the_script_finds_what_the_data_file_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Twenty seconds with each term: the cells of the page, and what remains below 0.1 %."""
    monkeypatch.setattr(sys, "argv", ["crosscheck", "--crane", "--out", str(tmp_path)])
    runpy.run_path(str(ROOT / "tests" / "crosscheck"), run_name="__main__")
    assert {path.name for path in tmp_path.iterdir()} == {"crane.md", "crane.png"}
    lines = [x for x in (tmp_path / "crane.md").read_text().splitlines() if x[:1] == "|"]
    found = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines[2:]]
    with (ROOT / "docs" / "data" / "crane.csv").open(newline="") as file:
        _, *listed = csv.reader(file)
    assert [row[:2] for row in found] == [row[:2] for row in listed]
    for row, known in zip(found, listed, strict=True):
        values, expected = (np.array(one[2:], dtype=float) for one in (row, known))
        np.testing.assert_allclose(values, expected, rtol=0.03, atol=2e-3)
    remains = {row[0]: float(row[2]) for row in found if row[1] == "none"}
    assert set(remains) == {PLAIN, EXUDYN, THROTTLED} and max(remains.values()) < 0.1
    assert PUMP == 7.6e6
