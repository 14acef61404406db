"""One run and its plant: what MuJoCo warns of ends it, and nobody else touches its state."""

import copy
import logging
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import cmf_mj
from cmf_mj import Hexapod, InputError, SingleLegs, load_law, simulate
from cmf_mj.control.states import Request
from cmf_mj.core.units import FRAME
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.facility.front import from_table
from cmf_mj.facility.replay import replay
from cmf_mj.facility.run import Run
from cmf_mj.facility.session import OutOfBounds, Session
from cmf_mj.facility.signal import ValveCommands
from cmf_mj.machine import models
from cmf_mj.plant.plant import Plant
from cmf_mj.studies.case import make_case
from tests.plant.test_attach_excavator import CYLINDERS

AT = 100  #: Control frame of the blow.


def session(plant: Plant) -> Session:
    return Run(plant=plant, source=from_table(np.zeros((2048, plant.legs)))).session()


def excavator() -> Plant:
    hydraulics = models.model_path("excavator_hydraulics.toml")
    return cmf_mj.attach_hydraulics(models.model_path("excavator.xml"), CYLINDERS, hydraulics)


def blow(plant: Plant, force: float) -> Session:
    """A run in which a force strikes the last body, up, and what is said of it."""
    run = session(plant)
    run.run(AT)
    run.push({plant.model.nbody - 1: (0.0, 0.0, force, 0.0, 0.0, 0.0)})
    return run


@pytest.mark.parametrize(
    ("machine", "law"), [("simona", None), ("lab", None), ("cmf", "modal_plan")]
)
def test_a_law_with_an_integral_keeps_a_machine_where_it_starts(
    machine: str, law: str | None
) -> None:
    """Also where equal piston areas leak under load, as SIMONA's, which sank by 0.36 mm. 0.1 um."""
    named = {} if law is None else {"law": law}
    moved = np.ptp(Run(machine=machine, duration=1.0, **named).record()["leg_extension"], axis=0)
    assert moved.max() < 1e-7


@pytest.mark.parametrize("name", ["simona", "lab"])
def test_a_law_of_a_machine_goes_by_its_name_on_it(name: str) -> None:
    plant, law = Hexapod(machine=name), f"{name}_plan"
    record = simulate(plant, law, np.zeros((8, 6)))
    assert record.metadata["law"] == Run(machine=name, law=law).first_law().name == law
    assert replay(record, law).law == law
    assert cmf_mj.Linear(plant).loop(law).ninputs == 6
    assert make_case(law, cab=cmf_mj.load_cab(machine=name)).law.name == law
    with pytest.raises(InputError, match=f"law: '{law}' is not one of original"):
        simulate(Hexapod(), law, np.zeros((8, 6)))


def test_electronics_go_by_name() -> None:
    still, chosen = np.zeros((64, 6)), ("noisy", ElectronicsSettings(), "ideal", None)
    named, made, ideal, none = (
        simulate(SingleLegs(), "velocity", still, electronics=one)["leg_position"] for one in chosen
    )
    np.testing.assert_array_equal(named, made)
    np.testing.assert_array_equal(ideal, none)
    assert (named != ideal).any()
    with pytest.raises(InputError, match="electronics: 'loud' is not one of ideal, noisy"):
        simulate(SingleLegs(), "velocity", still, electronics="loud")
    short: dict[str, Any] = {"legs": True, "command": still[:, : len(CYLINDERS)]}
    assert simulate(excavator(), "velocity", electronics="inertial", **short).time.size == 64
    with pytest.raises(InputError, match="gravity along the legs needs .* 'inertial'"):
        simulate(excavator(), "velocity", electronics="noisy", **short)


def test_an_open_loop_has_no_law_to_hand_over_from() -> None:
    """The law was taken, never ran, and the run said it was in force."""
    run = Run(plant=SingleLegs(), law=None, source=ValveCommands(np.zeros((8, 6)))).session()
    with pytest.raises(InputError, match="law: velocity is refused; allowed: in a loop closed"):
        run.engage(load_law("velocity"))
    assert run.law_in_force is None


def test_a_request_needs_a_host() -> None:
    with pytest.raises(InputError, match="request: HOLD is refused; allowed: in a run with a host"):
        session(SingleLegs()).request(Request.HOLD)


@pytest.mark.parametrize("plant", [Hexapod, SingleLegs, excavator])
@pytest.mark.parametrize("force", [1e300, -1e300, float("nan")])
def test_a_force_beyond_all_bounds_ends_the_run_with_its_name(
    plant: Callable[[], Plant], force: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """MuJoCo alone begins again at rest, and goes on as if nothing were."""
    monkeypatch.chdir(tmp_path)
    run = blow(plant(), force)
    with pytest.raises(OutOfBounds, match="MuJoCo warns of BADQACC") as ended:
        run.run()
    assert ended.value.frame == run.frame == AT
    assert str(ended.value).endswith(f" at {AT * FRAME:.4f} s")
    assert run.plant.data.time == pytest.approx((AT + 1) * FRAME)  # no reset
    assert run.history()[0].size == AT
    assert not list(tmp_path.iterdir())  # nor a log in the working folder


@pytest.mark.parametrize("number", range(len(mujoco.mjtWarning.__members__) - 1))
def test_every_warning_of_mujoco_ends_a_run(number: int) -> None:
    """Raised by hand in a healthy run: the run ends at the next frame, with its name."""
    run = session(SingleLegs())
    run.run(AT)
    run.plant.data.warning[number].number += 1
    name = mujoco.mjtWarning(number).name.removeprefix("mjWARN_")
    with pytest.raises(OutOfBounds, match=f"warns of {name} .* at {AT * FRAME:.4f} s"):
        run.run()
    assert run.frame == AT
    again = session(run.plant)
    again.run()
    assert again.frame == 2048


def test_bad_controls_of_other_motors_end_the_run() -> None:
    """MuJoCo sets all controls to zero instead, the cylinders' too."""
    text = """
    <mujoco model="lift"><option timestep="0.00048828125"/><worldbody>
      <body><joint name="ram" type="slide" axis="0 0 1" range="-.5 .5" limited="true"/>
        <geom size=".1" mass="3000"/>
        <body><joint name="spin" type="hinge"/><geom size=".1" mass="10"/></body></body>
    </worldbody><actuator><motor name="spin" joint="spin"/></actuator></mujoco>
    """
    plant = cmf_mj.attach_hydraulics(mujoco.MjSpec.from_string(text), ["ram"])
    run = Run(plant=plant, law=None, source=from_table(np.zeros((64, 1)))).session()
    run.run(8)
    plant.data.ctrl[plant.model.actuator("spin").id] = np.nan
    with pytest.raises(OutOfBounds, match="lift: MuJoCo warns of BADCTRL"):
        run.run()


def test_a_start_that_mujoco_warns_of_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    plant = SingleLegs()

    def place(pose: object) -> None:
        plant.data.warning[mujoco.mjtWarning.mjWARN_INERTIA].number += 1

    monkeypatch.setattr(plant, "place", place)
    with pytest.raises(InputError, match="start: MuJoCo warns of INERTIA .*; allowed: a state"):
        plant.start(np.zeros(6))


# One run at a time


def test_a_plant_is_refused_to_a_second_thread() -> None:
    """Both begin at once; one runs whole, the other is told so and changes nothing."""
    plant = Hexapod()
    run, alone = session(plant), session(Hexapod())
    said: list[str] = []
    inside = threading.Event()

    def second() -> None:
        inside.wait(10.0)
        for act in (run.run, plant.start, lambda: plant.configuration(np.zeros(6))):
            try:
                act()
            except InputError as error:
                said.append(str(error))

    thread = threading.Thread(target=second)
    thread.start()
    with plant.alone:
        inside.set()
        thread.join()
    assert said == ["plant: another thread runs it; allowed: a plant for each thread"] * 3
    run.run()
    alone.run()
    np.testing.assert_array_equal(
        run.history()[1]["cap_pressure"], alone.history()[1]["cap_pressure"]
    )


def test_a_plant_that_was_started_again_ends_the_run_before() -> None:
    plant = SingleLegs()
    first = session(plant)
    first.run(AT)
    second = session(plant)
    with pytest.raises(InputError, match="plant: has been reset since; allowed: one run at a time"):
        first.run()
    second.run(AT)
    plant.reflected_mass()  # a question that needs the machine at neutral
    with pytest.raises(InputError, match="plant: has been reset"):
        second.run()


def test_a_copy_of_a_plant_is_free() -> None:
    plant = SingleLegs()
    with plant.alone:
        session(copy.deepcopy(plant)).run(8)


def test_warnings_can_be_heard(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "mujoco")
    with pytest.raises(OutOfBounds):
        blow(SingleLegs(), 1e300).run()
    assert "unstable" in caplog.text
