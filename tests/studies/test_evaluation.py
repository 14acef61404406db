"""What a case of a study measures: the linear method against the simulation, on drawn machines."""

import control
import numpy as np
import pytest

from cmf_mj import Hexapod, load_cab, load_law
from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.analysis.linear.loop import loop_steps
from cmf_mj.core.units import FRAME
from cmf_mj.facility.unknowns import Unknowns
from cmf_mj.machine.geometry import DOFS
from cmf_mj.studies.evaluation import StudyRow, evaluate
from cmf_mj.studies.settings import NOMINAL, load_study


def test_step_responses_in_blocks_are_those_of_the_library() -> None:
    generator = np.random.default_rng(3)
    matrix = generator.normal(size=(5, 5))
    matrix *= 0.98 / np.abs(np.linalg.eigvals(matrix)).max()
    system = control.ss(
        matrix,
        generator.normal(size=(5, 2)),
        generator.normal(size=(2, 5)),
        generator.normal(size=(2, 2)),
        FRAME,
    )
    steps = loop_steps(system)
    time = np.arange(200) * FRAME
    for i in range(2):
        expected = control.step_response(system, time, input=i).outputs[:, 0]
        assert steps[:200, :, i].T == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.fixture(scope="module")
def measured() -> dict[tuple[str, int], list[StudyRow]]:
    """The velocity law, nominal and drawn, linear and simulated at the report's sizes or small."""
    shipped = load_study("mismatch").settings.model_dump()["mismatch"]
    kept = {name: shipped[name] for name in ("valve_flow", "leak_rate", "leg_velocity")}
    table = {"title": "test", "laws": ["velocity"], "draws": 1, "mismatch": kept}
    found = {
        ("linear", case.draw): evaluate(case)
        for case in load_study(table | {"method": "linear"}).cases
    }
    for name, inches in (("report", 0.33), ("small", 0.08)):
        swept = load_study(table | {"method": "sweep", "amplitude": inches}).cases
        drawn = [case for case in swept if case.draw != NOMINAL]
        found[name, 0] = [row for case in drawn for row in evaluate(case)]
    return found


def test_a_symmetric_machine_keeps_its_halves_apart_and_a_drawn_one_does_not(
    measured: dict[tuple[str, int], list[StudyRow]],
) -> None:
    """Surge, heave and pitch move in the plane of symmetry; sway, roll and yaw out of it."""
    inside = {"surge", "heave", "pitch"}
    for row in measured["linear", NOMINAL]:
        for moved in set(DOFS) - {row.dof}:
            value = row.crosstalk[DOFS.index(moved)]
            if (row.dof in inside) != (moved in inside):
                assert value < 1e-6, (row.dof, moved)
    surge = measured["linear", 0][0]
    assert surge.crosstalk[1] > 0.05
    assert np.isnan(surge.crosstalk[0])


def test_the_linear_method_agrees_with_the_simulation_on_a_drawn_machine(
    measured: dict[tuple[str, int], list[StudyRow]],
) -> None:
    """Small sweeps, since larger ones open the valves wider, and the report's steps: -90 deg
    within 4 %, damping ratio within 0.04, verdicts alike, six degrees of freedom."""
    rows = zip(measured["linear", 0], measured["small", 0], measured["report", 0], strict=True)
    for one, small, step in ((row.measures for row in rows_) for rows_ in rows):
        assert one.stable and small.stable and step.stable
        assert one.phase_bandwidth_hz == pytest.approx(small.phase_bandwidth_hz, rel=0.04)
        assert one.damping_ratio == pytest.approx(step.damping_ratio, abs=0.04)
        assert one.peak_gain_db == pytest.approx(small.peak_gain_db, abs=1.5)


def test_what_differs_from_draw_to_draw_may_be_the_cab_or_the_law() -> None:
    """A drawn machine is the one that its numbers make, put together by hand."""
    known = {"source": "test"}
    pole = {"low": 75.0, "high": 105.0, "unit": "rad/s", "effect": "value"}
    unknowns = {
        "mass": known | {"path": "cab.mass", "deviation": 10.0},
        "pole": known | {"path": "law.derivative_pole"} | pole,
    }
    table = {"title": "test", "method": "linear", "laws": ["position_error_rate"], "draws": 1}
    study = load_study(table | {"mismatch": unknowns})
    values, gfd = Unknowns(study.settings.mismatch).streams(0, 0), load_cab("gfd")
    cab = gfd.changed("mine", mass=values["mass"] * gfd.mass.si, nominal=gfd)
    law = load_law("position_error_rate").model_copy(update={"derivative_pole": values["pole"]})
    expected = Linear(Hexapod(cab)).measures(law)
    (nominal, drawn) = (
        [row.measures.phase_bandwidth_hz for row in evaluate(c)] for c in study.cases
    )
    assert drawn == pytest.approx([one.phase_bandwidth_hz for one in expected], rel=1e-9)
    assert nominal != pytest.approx(drawn, rel=1e-3)
