"""Runs at other control rates than the facility's 2048 Hz."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from identified_systems import excited

from cmf_mj import Hexapod, load_cab, load_law, simulate
from cmf_mj.analysis.identification import experiment, identify
from cmf_mj.core.errors import InputError
from cmf_mj.core.quantity import Quantity
from cmf_mj.facility.host.stream import make_stream
from cmf_mj.facility.host_chain import dcu_of
from cmf_mj.facility.operation import operate
from cmf_mj.facility.scenario import scenario_of
from cmf_mj.machine import models
from cmf_mj.machine.machine import Machine, load_machine
from cmf_mj.record.record import Record
from cmf_mj.signals.signal import Command
from cmf_mj.signals.single import step
from cmf_mj.studies.case import make_case

STEP = step("heave", 0.0254, at=0.5, duration=1.5)


def machine(rate: int) -> Machine:
    """The CMF with one cab and another control rate."""
    cmf = load_machine()
    hertz = Quantity(value=rate, unit="Hz", status="assumed", source="test")
    return load_machine(
        cmf.model_copy(
            update={"name": "other", "control_rate": hertz, "cabs": {"deck": cmf.cabs["gfd"]}}
        )
    )


@cache
def stepped(rate: int) -> Record:
    return simulate(Hexapod(machine=machine(rate)), "velocity", STEP)


@pytest.mark.parametrize("rate", [500, 1024, 2048, 5000])
def test_the_mechanical_step_divides_the_frame_and_is_no_longer_than_the_facility_s(
    rate: int,
) -> None:
    step = Hexapod(machine=machine(rate)).model.opt.timestep
    count = 1.0 / (rate * step)
    assert count == pytest.approx(round(count), abs=1e-9)
    assert step <= 1.0 / 2048


def test_a_step_approaches_that_of_short_frames_in_proportion_to_the_frame() -> None:
    """Delay and holds are whole frames, so the overshoot grows by an equal part of each frame.

    20 %: terms of the second order in a frame of 1 ms.
    """
    top = {rate: stepped(rate)["platform_pose"][:, 2].max() for rate in (1024, 2048, 5000, 10_000)}
    slopes = [
        (top[rate] - top[10_000]) / (1.0 / rate - 1.0 / 10_000) for rate in (5000, 2048, 1024)
    ]
    assert slopes[0] > 0.0
    np.testing.assert_allclose(slopes, slopes[0], rtol=0.2)


def test_a_record_knows_its_rate() -> None:
    record = stepped(5000)
    assert record.rate == 5000.0
    assert record.time.size == 7500 and record.time[-1] == pytest.approx(7499 / 5000)
    assert record.metadata["law_parameters"]["rate"] == 5000
    assert record.signal.rate == 5000


def test_poses_of_another_rate_are_refused() -> None:
    plant = Hexapod(machine=machine(1000))
    with pytest.raises(InputError, match="2048 a second; the machine takes 1000 a second"):
        simulate(plant, "velocity", Command.from_pose(np.zeros((100, 6))))


def test_the_facility_follows_a_host_at_another_rate() -> None:
    """1 s after its last change the demand of a slow wave is where the host has it, at any rate.

    Oracle: the host's quintic at the time less the delays, counted in frames of the rate.
    """
    time = np.arange(240) / 80.0
    pose = np.zeros((240, 6))
    pose[:, 2] = 0.02 * (1.0 - np.cos(np.pi * time))
    for rate in (1000, 2048):
        plant = Hexapod(machine=machine(rate))
        run = operate(plant, "velocity", make_stream(time, pose), electronics=None, record_every=10)
        delay = sum(dcu_of(plant.machine).delay.parts(rate).values())
        late = run.record.time[(run.record.time > 1.5) & (run.record.time < 2.8)]
        demand = np.interp(late, run.record.time, run.record["demand_pose"][:, 2])
        meant = 0.02 * (1.0 - np.cos(np.pi * (late - delay)))
        np.testing.assert_allclose(demand, meant, rtol=0, atol=0.064 / rate)
    assert load_law("velocity").rate == 2048


def test_a_scenario_runs_at_the_rate_of_its_machine(tmp_path: Path) -> None:
    """Changes, events and the end fall on the same times; the demand is that of the signal."""
    text = (models.directory() / "machines" / "lab.toml").read_text()
    assert "control_rate" not in text
    text = text.replace("laws/lab.toml", "original")
    slow = text.replace('name = "lab"', 'name = "slow"', 1).replace(
        "[gimbals]",
        '[control_rate]\nvalue = 1000\nunit = "Hz"\nstatus = "assumed"\nsource = "test"\n[gimbals]',
        1,
    )
    (file := tmp_path / "slow.toml").write_text(slow)
    scenario = scenario_of(
        {
            "machine": str(file),
            "signal": [{"kind": "sine", "dof": "heave", "amplitude": 0.01, "frequency": 2.0}],
            "change": [{"at": 0.5, "signal": [], "fade": 0.2}],
            "duration": 1.0,
        },
        "test",
    )
    record = scenario.record()
    assert record.rate == 1000.0 and record.time.size == 1000
    time = record.time[:500]
    meant = 0.005 * (1.0 - np.cos(np.pi * time)) * np.sin(4.0 * np.pi * time)
    np.testing.assert_allclose(record["demand_pose"][:500, 2], meant, rtol=0, atol=1e-12)
    assert np.abs(record["demand_pose"][700:]).max() == 0.0


def test_identification_works_at_the_rate_of_the_machine() -> None:
    """200 Hz is no multiple of 64: the lag's pole is found at 66.7 Hz, to its 3 Hz."""
    own = machine(1000)
    case = make_case("velocity", "heave", "single_legs", load_cab("deck", own))
    found = identify(excited(case), "heave")
    assert found.box.step == pytest.approx(0.015)
    corner = [-np.log(r.value.real) / 0.015 for r in found.box.poles() if r.value.imag == 0.0]
    assert max(corner) == pytest.approx(2.0 * np.pi * 3.0, rel=0.05)
    assert experiment(stepped(1000), "heave").step == pytest.approx(0.015)  # 64 Hz divides none
