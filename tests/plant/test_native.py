"""What the loop steps is the drawn machine to the bit, without what nobody looks at or reads."""

import ctypes
import threading

import mujoco
import numpy as np
import pytest

from cmf_mj import Hexapod, InputError, SingleLegs, signals, simulate
from cmf_mj.plant import native
from cmf_mj.plant.hexapod import hexapod_model, hexapod_spec
from cmf_mj.plant.native import headless, without_sensors
from cmf_mj.plant.plant import Plant


def driven(model: mujoco.MjModel, frames: int = 1000) -> np.ndarray:
    """State after random forces, a push that turns the platform, and legs against their stops."""
    data, random = mujoco.MjData(model), np.random.default_rng(7)
    load = Hexapod().static_load()
    data.xfrc_applied[model.body("platform").id] = 2e4, 1e4, 0.0, 0.0, 3e4, 1e4
    stopped = False
    for _ in range(frames):
        data.ctrl[:] = load * random.uniform(0.0, 6.0, 6)
        mujoco.mj_step(model, data)
        stopped |= data.sensor("stop_force_1").data[0] > 0.0
    assert stopped
    return np.concatenate([data.qpos, data.qvel, data.qacc])


@pytest.mark.parametrize("cab", ["gfd", "rfd", "ifd"])
def test_a_model_without_geoms_moves_as_the_drawn_one(cab: str) -> None:
    plant = Hexapod(cab)
    drawn = hexapod_model(cab)
    assert drawn.ngeom > 250
    assert plant.model.ngeom == plant.model.ncam == plant.model.nlight == plant.model.nmesh == 0
    np.testing.assert_array_equal(driven(plant.model), driven(drawn))


def test_a_model_without_sensors_moves_as_one_with_them() -> None:
    model = hexapod_model()
    data = [mujoco.MjData(model) for _ in range(2)]
    for one, other in zip(data, (model, without_sensors(model)), strict=True):
        for _ in range(50):
            mujoco.mj_step(other, one)
    np.testing.assert_array_equal(data[0].qpos, data[1].qpos)
    assert data[0].sensordata.any() and not data[1].sensordata.any()


def test_geoms_that_touch_or_weigh_stay() -> None:
    spec = mujoco.MjSpec()
    spec.worldbody.add_camera(name="camera")
    for name, collides, inertia in (("ghost", 0, True), ("solid", 1, True), ("heavy", 0, False)):
        body = spec.worldbody.add_body(name=name, mass=2.0, inertia=[1.0, 1.0, 1.0])
        body.explicitinertial = inertia
        body.add_freejoint()
        body.add_geom(name=name, size=[0.1] * 3, contype=collides, conaffinity=collides)
    model = headless(spec)
    assert [model.geom(i).name for i in range(model.ngeom)] == ["solid", "heavy"]
    assert model.ncam == 0 and spec.cameras, "the spec itself must stay as it is"
    np.testing.assert_array_equal(model.body_mass, spec.compile().body_mass)


@pytest.mark.parametrize("make", [Hexapod, SingleLegs, lambda: Hexapod(spec=hexapod_spec())])
def test_the_machine_can_be_drawn(make: type[Plant]) -> None:
    plant = make()
    drawn = plant.drawn_model
    assert drawn.ngeom > plant.model.ngeom == 0
    assert drawn.nq == plant.model.nq
    for kind in ("body", "joint", "site"):
        count = getattr(drawn, f"n{'jnt' if kind == 'joint' else kind}")
        names = [[getattr(m, kind)(i).name for i in range(count)] for m in (drawn, plant.model)]
        assert names[0] == names[1]


def test_rows_hold_the_sensors_of_their_frame_however_many_are_left_out() -> None:
    """Sensors are computed only for the rows: every sixteenth row must be that of the full run."""
    command = signals.step("pitch", 0.02, at=0.01, duration=0.1)
    every = [simulate(Hexapod(), "acceleration", command, record_every=n) for n in (1, 16)]
    assert every[0]["rod_accelerometer"].std(axis=0).min() > 0.0
    for name in every[1].channels:
        if name not in ("time", "gimbal_error"):  # the latter is the largest since the row before
            np.testing.assert_array_equal(every[1][name], every[0][name][::16], err_msg=name)


def test_a_second_start_is_the_first_and_notices_what_was_changed() -> None:
    plant, pose = Hexapod(), np.array([0.1, 0.0, -0.1, 0.05, 0.0, 0.1])
    first = plant.start(pose)
    sensors = plant.data.sensordata.copy()
    plant.start()
    plant.start(pose)
    again = plant.start(pose)
    np.testing.assert_array_equal(again.pressure, first.pressure)
    np.testing.assert_array_equal(plant.data.sensordata, sensors)
    plant.model.body("platform").mass *= 1.01
    with pytest.raises(InputError, match="platform"):
        plant.start(pose)


def test_the_clock_of_mujoco_is_set_again_by_the_last_to_leave() -> None:
    clock = ctypes.c_void_p.in_dll(native._library(), "mjcb_time")
    before = clock.value
    assert before, "MuJoCo has no clock: the test would prove nothing"
    entered, leave = threading.Event(), threading.Event()

    def inside() -> None:
        with native.without_clock():
            entered.set()
            leave.wait(30)

    thread = threading.Thread(target=inside)
    with native.without_clock():
        thread.start()
        entered.wait(30)
        assert clock.value is None
    assert clock.value is None, "another run is still under way"
    leave.set()
    thread.join()
    assert clock.value == before
