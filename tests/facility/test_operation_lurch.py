"""Raising from the stops (section 3.2.1): smooth with the integrator's trigger, a lurch without."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from cmf_mj.control.states import State
from cmf_mj.facility.operation import Operation

INCH = 0.0254
SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "figures.py"
WAIT = 30.0


@pytest.fixture(scope="module")
def runs() -> dict[str, Operation]:
    script = runpy.run_path(str(SCRIPT))
    return {
        name: script["rise"](*case, wait=WAIT, after=after)
        for (name, case), after in zip(script["CASES"].items(), (4.0, 1.6, 3.0), strict=True)
    }


def speed(run: Operation) -> float:
    """Largest leg speed [in/s]."""
    return np.abs(np.diff(run.record["leg_extension"], axis=0)).max() * run.record.rate / INCH


def test_with_the_trigger_the_legs_rise_smoothly(runs: dict[str, Operation]) -> None:
    """No faster than the valve fade lets the law's own offset, 2.6 in at the stops, be made up."""
    run = runs["with the trigger"]
    assert run.record.metadata["fault"] is None
    assert run.record["operating_state"][-1] == State.RAISE
    assert run.record["leg_extension"].max() < -33.0 * INCH
    assert speed(run) < 12.0


def test_without_it_they_lurch(runs: dict[str, Operation]) -> None:
    """0.45 in for 30 s are 13 in s, at 50 %/(in s) more than six times full command."""
    run = runs["without, unprotected"]
    assert speed(run) > 28.0
    assert run.record["valve_command"].max() > 0.75
    over = run.record["leg_extension"] - run.record["leg_reference"]
    assert over.max() > 7.0 * INCH


def test_the_protection_stops_the_lurch(runs: dict[str, Operation]) -> None:
    run = runs["without, protected"]
    assert run.record.metadata["fault"]["name"] == "tracking_error"
    assert run.record["isolation"][-1] == 1.0
    assert (
        run.record["leg_extension"].max()
        < runs["without, unprotected"].record["leg_extension"].max() - 3.0 * INCH
    )
    late = run.record.time > WAIT + 2.9
    assert (run.record["leg_extension"][late] < -37.0 * INCH).all()
