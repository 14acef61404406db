"""Closed loops in MuJoCo against the IFToMM library's mechanisms and references without MuJoCo."""

from pathlib import Path

import numpy as np
import pytest
from crosscheck import loops, mechanisms
from crosscheck.loops import DEFAULT, HOLD, TRIED, Outcome, Settings, hexapod, outcome, run
from shared import rows_of

from cmf_mj import Hexapod

DATA = Path(__file__).resolve().parents[2] / "docs" / "data"
B0_OF_EXUDYN = np.array([[0.3284552113, 0.9445195467], [0.3284573768, 0.9445187937]])
"""B0 of A02 at 10 s as Exudyn's double four-bar example prints it, steps of 1/4000 and 1/8000 s."""


@pytest.fixture(scope="module")
def found() -> dict[str, list[Outcome]]:
    """Euler at a step and at a quarter of it, RK4, and the default pins."""
    tried = (
        *(Settings("Euler"), Settings("Euler", parts=4)),
        *(Settings("RK4"), Settings("Euler", "default")),
    )
    systems = {
        "A02": lambda each: outcome(mechanisms.four_bars(), each),
        "A03": lambda each: outcome(mechanisms.squeezer(), each),
        "CMF": lambda each: hexapod(each, 2.0),
    }
    return {name: [of(each) for each in tried] for name, of in systems.items()}


def test_the_four_bars_are_those_of_exudyn() -> None:
    """Richardson's extrapolation of its two finest runs, which are of second order."""
    coarse, fine = B0_OF_EXUDYN
    limit = fine + (fine - coarse) / 3.0
    times = np.array([0.0, 10.0])
    np.testing.assert_allclose(mechanisms.four_bars_reference(times)[1], limit, rtol=0, atol=2e-8)


def test_andrews_squeezer_reaches_the_coordinates_of_the_test_set() -> None:
    """All seven after 2.5 turns of the crank, 0.03 s: published to 14 digits."""
    states, times = run(mechanisms.squeezer(), Settings("RK4"))
    at = int(np.argmin(np.abs(times - mechanisms.TESTSET_TIME)))
    there = mechanisms.squeezer_coordinates(states.positions[at])
    np.testing.assert_allclose(there, mechanisms.TESTSET, rtol=0, atol=5e-6)


def test_bricards_mechanism_follows_its_one_freedom() -> None:
    """P3 to 0.2 um, over 1.5 s in which it travels by more than 1 m."""
    states, times = run(mechanisms.bricard()._replace(seconds=1.5), Settings("RK4"))
    points = mechanisms.bricard_points(states.positions[::128])
    exact = mechanisms.bricard_reference(times[::128])
    assert np.ptp(exact[:, 0]) > 1.0
    assert np.abs(points - exact).max() < 2e-7


def test_the_hexapod_has_the_pins_that_are_measured() -> None:
    model = Hexapod().model
    np.testing.assert_array_equal(model.eq_solref, [[2.0 * model.opt.timestep, 1.0]] * 6)
    np.testing.assert_array_equal(model.eq_solimp, [HOLD] * 6)
    assert HOLD != DEFAULT[1]


@pytest.mark.parametrize("name", ["A02", "A03", "CMF"])
def test_errors_of_euler_fall_with_the_step(found: dict[str, list[Outcome]], name: str) -> None:
    """Of first order in the energy, of at least first in the gap."""
    whole, quarter, *_ = found[name]
    assert whole.energy / quarter.energy == pytest.approx(4.0, rel=0.15)
    assert whole.gap > 4.0 * quarter.gap


@pytest.mark.parametrize("name", ["A02", "A03", "CMF"])
def test_rk4_keeps_the_energy_and_default_pins_lose_it(
    found: dict[str, list[Outcome]], name: str
) -> None:
    euler, _, rk4, default = found[name]
    assert rk4.energy < 0.01 * euler.energy
    assert default.energy > 20.0 * euler.energy
    assert default.gap > 1e3 * euler.gap
    assert default.drift < 0.0


def test_dampers_across_branches_need_the_discrete_integrator() -> None:
    """The slider of A05: the error of `discrete` is of first order, `implicitfast` has none."""
    balls = mechanisms.flyballs()._replace(seconds=3.0)
    tried = [Settings(name, parts=k) for name in ("discrete", "implicitfast") for k in (1, 4)]
    whole, quarter, *fast = (outcome(balls, each).point for each in tried)
    assert whole < 0.01
    assert whole / quarter == pytest.approx(4.0, rel=0.15)
    assert min(fast) > 10.0 * whole


def cells(path: Path) -> list[dict[str, str]]:
    """Rows of a table but for times, which are of a machine, and versions."""
    left_out = {"CMF [us a step]", "CPU time [s]", "program"}
    return [{name: row[name] for name in row if name not in left_out} for row in rows_of(path)]


@pytest.mark.slow
def test_regression_tables_of_the_page_are_measured(tmp_path: Path) -> None:
    """To 5 %, for another processor's rounding, and of energies that RK4 keeps to 1 uJ."""
    paths = loops.save_loops(tmp_path)
    rows = [
        pair for path in paths for pair in zip(cells(path), cells(DATA / path.name), strict=True)
    ]
    assert len(rows) > 2 * len(TRIED)
    for here, there in rows:
        for name, cell in here.items():
            if "[" not in name or not cell:
                assert cell == there[name], (name, here)
            else:
                small = 1e-6 if "energy" in name else 1e-3
                assert float(cell) == pytest.approx(float(there[name]), rel=0.05, abs=small), name
