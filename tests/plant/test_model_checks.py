"""What a plant refuses: a model that is not the machine of kinematics, hydraulics and cab."""

import re
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest
from hydraulic_equations import changed

from cmf_mj import Hexapod, InputError, SingleLegs
from cmf_mj.facility.simulate import drive
from cmf_mj.machine.cab import load_cab
from cmf_mj.plant.attach import attach_hydraulics
from cmf_mj.plant.hexapod import hexapod_spec
from cmf_mj.plant.plant import Plant

STILL = np.zeros((4, 6))

SLIDE = """
<mujoco model="slide">
  <option timestep="0.00048828125" gravity="0 0 0"/>
  <worldbody>
    <body name="load">
      <joint name="leg" type="slide" axis="0 0 1" {joint}/>
      <inertial pos="0 0 0" mass="3000" diaginertia="1 1 1"/>
    </body>
    <body name="other" pos="0 0 {gap}">
      <joint name="free" type="slide" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="10" diaginertia="1 1 1"/>
    </body>
  </worldbody>
  <equality><connect name="pin" body1="load" body2="other" anchor="0 0 0"/></equality>
  <actuator><motor name="leg" joint="leg"/></actuator>
</mujoco>
"""


def slide(joint: str = "", gap: float = 0.0) -> Plant:
    model = mujoco.MjModel.from_xml_string(SLIDE.format(joint=joint, gap=gap))
    # `connect` takes its second anchor from qpos0; the gap opens when that is moved afterwards.
    model.eq_data[0, 3:6] = 0.0
    return Plant(model)


OFF = int(mujoco.mjtDisableBit.mjDSBL_EQUALITY)


def moved(place: Any, factor: float, by: Any = 0.0) -> None:
    place[:] = factor * np.array(place) + by


def box(spec: mujoco.MjSpec, mass: float) -> None:
    body = spec.body("platform").add_body(name="box", pos=[0.5, 0.0, 1.0])
    body.mass, body.ipos, body.inertia = mass, [0.0, 0.0, 0.0], [4.0, 5.0, 6.0]
    body.explicitinertial = True


EDITS: dict[str, tuple[Callable[[Any], object], str]] = {
    "lower gimbals": (
        lambda spec: [moved(spec.body(f"cylinder_{leg}").pos, 1.01) for leg in range(1, 7)],
        "spec: lower gimbal 1 is [ 1.697525 -2.41045 -3.414034] m in the model, "
        "[ 1.680718 -2.386584 -3.380232] m in the kinematics; allowed: both the same",
    ),
    "upper gimbal": (
        lambda spec: moved(spec.site("upper_4").pos, 1.0, [0.0, 1e-6, 0.0]),
        "upper gimbal 4 on the platform is [-1.357122 1.894333 -0.00127 ] m in",
    ),
    "platform": (
        lambda spec: moved(spec.body("platform").pos, 0.0, [0.0, 0.0, 0.01]),
        "upper gimbal 1 at neutral is [ 2.31902 -0.228092 0.00873 ] m in the model",
    ),
    "rod end": (
        lambda spec: moved(spec.site("rod_end_2").pos, 1.0, [0.0, 0.0, 1e-3]),
        "spec: rod end 2 at neutral is [-0.962437 -2.122294 -0.000438] m in the model",
    ),
    "cylinder pin": (
        lambda spec: setattr(spec.joint("gimbal_5_y"), "pos", [0.0, 0.0, 0.002]),
        "spec: joint gimbal_5_y is [ 1.225488 2.648707 -3.378568] m in the model",
    ),
    "leg axis": (
        lambda spec: setattr(spec.joint("leg_6"), "axis", [0.0, 0.01, 1.0]),
        "spec: axis of leg 6 at neutral is [",
    ),
    "loose pin": (
        lambda spec: setattr(spec.equality("gimbal_3"), "active", False),
        "spec: gimbal_3 does not pin the rod to the platform; allowed: an active",
    ),
    "no pins": (
        lambda spec: setattr(spec.option, "disableflags", spec.option.disableflags | OFF),
        "spec: gimbal_1 does not pin the rod to the platform; allowed: an active",
    ),
    "missing site": (
        lambda spec: setattr(spec.site("rod_end_1"), "name", "elsewhere"),
        "spec: does not compile: Error: unknown element 'rod_end_1'",
    ),
    "missing joint": (
        lambda spec: setattr(spec.joint("gimbal_2_y"), "name", "elsewhere"),
        "spec: has no joint 'gimbal_2_y'; allowed: the names of the shipped model",
    ),
    "heavy cab": (
        lambda spec: setattr(spec.body("cab/cab"), "mass", 1.001 * spec.body("cab/cab").mass),
        "cab: mass of platform and cab is 13580.555194 kg in the model, 13571.4837",
    ),
    "shifted cab": (
        lambda spec: moved(spec.body("cab/cab").ipos, 1.0, [0.0, 0.0, 1e-4]),
        "cab: centre of mass of platform and cab is [0.066842 0. 0.584805] m in",
    ),
    "slow cab": (
        lambda spec: moved(spec.body("cab/cab").inertia, 1.001),
        "cab: inertia of platform and cab is [[23",
    ),
    "light rod": (
        lambda spec: setattr(spec.body("rod_2"), "mass", 149.0),
        "cab: mass of rod_2 is 149. kg in the model, 150. kg in 'gfd'; allowed: both",
    ),
    "box on board": (
        lambda spec: box(spec, 100.0),
        "cab: mass of platform and cab is 13671.48371 kg in the model, 13571.4837",
    ),
    "shorter stops": (
        lambda spec: setattr(spec.joint("leg_1"), "range", [-0.9652, 0.95]),
        "half_stroke: set 'hardware' gives leg_1 +-0.9652 m, the model stops it at -0.9652 "
        "and 0.95 m from neutral; allowed: both the same",
    ),
}


@pytest.mark.parametrize(("edit", "said"), EDITS.values(), ids=EDITS)
def test_an_edited_machine_is_refused_with_both_values(
    edit: Callable[[mujoco.MjSpec], object], said: str
) -> None:
    spec = hexapod_spec("gfd")
    edit(spec)
    with pytest.raises(InputError, match=re.escape(said)):
        Hexapod("gfd", spec=spec)


def test_a_cab_is_what_the_model_carries() -> None:
    """The box as a body of its own, stated as one cab: two bodies by the parallel-axis theorem."""
    cab, mass, place = load_cab("gfd"), 100.0, np.array([0.5, 0.0, 1.0])
    total = cab.mass.si + mass
    centre = (cab.mass.si * np.array(cab.centre_of_mass.si) + mass * place) / total
    inertia = cab.tensor + np.diag([4.0, 5.0, 6.0])
    for part, at in ((cab.mass.si, np.array(cab.centre_of_mass.si)), (mass, place)):
        arm = at - centre
        inertia += part * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    spec = hexapod_spec("gfd")
    box(spec, mass)
    loaded = cab.changed("with box", mass=total, centre_of_mass=centre, inertia=inertia)
    machine = Hexapod(loaded, spec=spec)
    machine.start([0.1, 0.0, -0.2, 0.1, 0.0, 0.0])
    assert machine.describe()["cab"] == "with box"
    np.testing.assert_allclose(
        machine.reflected_mass(), Hexapod(loaded).reflected_mass(), rtol=1e-9, atol=1e-6
    )


def test_what_carries_no_mass_may_be_added() -> None:
    spec = hexapod_spec("ifd")
    spec.body("platform").add_site(name="instrument", pos=[1.0, 0.0, 0.5])
    record = drive(Hexapod("ifd", spec=spec), STILL)
    shipped = drive(Hexapod("ifd"), STILL)
    np.testing.assert_array_equal(record["leg_force"], shipped["leg_force"])


@pytest.mark.parametrize("half", [0.9, 1.0])
@pytest.mark.parametrize("plant", [Hexapod, SingleLegs])
def test_another_stroke_than_the_stops_is_refused(
    plant: type[Hexapod] | type[SingleLegs], half: float
) -> None:
    said = (
        f"half_stroke: set 'other' gives leg_1 +-{half:g} m, the model stops it at -0.9652 and "
        "0.9652 m from neutral; allowed: both the same"
    )
    with pytest.raises(InputError, match=re.escape(said)):
        plant(hydraulics=changed("hardware", name="other", half_stroke=(half, "m")))


def test_a_hexapod_has_the_stroke_of_the_kinematics() -> None:
    """Model and hydraulics may agree and still be another machine."""
    spec = hexapod_spec("gfd")
    for leg in range(1, 7):
        spec.joint(f"leg_{leg}").range = [-1.0, 1.0]
    said = "set 'other' gives leg_1 +-1 m, the kinematics +-0.9652 m; allowed: both the same"
    with pytest.raises(InputError, match=re.escape(said)):
        Hexapod("gfd", changed("hardware", name="other", half_stroke=(1.0, "m")), spec=spec)


@pytest.mark.parametrize(
    ("part", "factor", "said"),
    [
        (
            lambda machine: machine.model.body("cab/cab").mass,
            2.0,
            "cab: mass of platform and cab is 22642.967421 kg in the model",
        ),
        (
            lambda machine: machine.model.joint("leg_2").range[1:],
            0.5 / 0.9652,
            "half_stroke: set 'hardware' gives leg_2 +-0.9652 m, the model stops it at -0.9652",
        ),
        (
            lambda machine: machine.model.body("cylinder_1").pos,
            1.01,
            "spec: lower gimbal 1 is [ 1.697525",
        ),
        (
            lambda machine: machine.hydraulics.cylinder.half_stroke[3:4],
            0.9 / 0.9652,
            "half_stroke: set 'hardware' gives leg_4 +-0.9 m",
        ),
    ],
)
def test_a_run_checks_again(part: Callable[[Hexapod], Any], factor: float, said: str) -> None:
    """Between construction and run a model can be edited, or be left edited by another run."""
    machine = Hexapod("gfd")
    drive(machine, STILL)
    moved(part(machine), factor)
    with pytest.raises(InputError, match=re.escape(said)):
        drive(machine, STILL)


def test_a_pose_that_opens_a_gimbal_is_refused() -> None:
    """The x and y axes of a lower gimbal exchanged: closed at neutral and nowhere else."""
    spec = hexapod_spec("gfd")
    spec.joint("gimbal_1_x").axis, spec.joint("gimbal_1_y").axis = [0, 1, 0], [1, 0, 0]
    machine = Hexapod("gfd", spec=spec)
    machine.start()
    with pytest.raises(
        InputError, match=r"start: the loop 'gimbal_1' is open by .* m; allowed: 1e"
    ):
        machine.start([0.3, 0.0, 0.0, 0.0, 0.1, 0.0])


def test_any_model_has_its_stops_within_the_stroke() -> None:
    slide('range="-0.5 0.9652"').start()
    slide().start()
    said = (
        "gives leg +-0.9652 m, the model stops it at -0.5 and 0.97 m from neutral; allowed: stops"
    )
    with pytest.raises(InputError, match=re.escape(said)):
        slide('range="-0.5 0.97"')
    rope = mujoco.MjSpec.from_string(
        '<mujoco model="hoist"><worldbody><site name="hook" pos="0 0 3"/><body><joint type="slide" '
        'axis="0 0 1"/><geom size="0.1"/><site name="eye"/></body></worldbody><tendon><spatial '
        'name="rope"><site site="hook"/><site site="eye"/></spatial></tendon></mujoco>'
    )
    hoist = attach_hydraulics(rope, {"rope": 2.5}, "hardware")
    hoist.model.tendon_range[0, 1] += 0.01
    with pytest.raises(InputError, match="gives rope .* stops it at -0.9652 and 0.9752 m from"):
        hoist.start()


def test_an_open_loop_of_any_model_is_refused_and_can_be_closed() -> None:
    apart = slide(gap=0.029)
    with pytest.raises(
        InputError, match=r"start: the loop 'pin' is open by 0.029 m; allowed: 1e-06"
    ):
        drive(apart, np.zeros((4, 1)))
    drive(apart, np.zeros((4, 1)), start=apart.configuration([0.0]))
