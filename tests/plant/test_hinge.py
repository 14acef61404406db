"""A hinge with a motor becomes a cylinder: geometry, torque and pressures in closed form."""

import mujoco
import numpy as np
import pytest

from cmf_mj import InputError, attach_to_hinges, drive, load_hydraulics
from cmf_mj.plant.hinge import HingeCylinder

MASS, REACH, GRAVITY = 200.0, 1.2, 9.81
ARM = """
<mujoco model="arm">
  <compiler angle="radian"/>
  <worldbody>
    <body pos="0.3 0.2 2" euler="0.3 0 0.4">
      <joint name="shoulder" axis="0 1 0" range="{low} {high}" ref="{ref}" pos="0.1 0 0"/>
      <inertial pos="1.3 0 0" mass="200" diaginertia="1 1 1"/>
    </body>
    <body>
      <joint name="spare" type="slide" axis="1 0 0" range="-1 1"/>
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="pull" joint="shoulder" gear="50" ctrlrange="-40 100"/>
    <motor name="more" joint="shoulder" ctrlrange="-500 500" forcerange="-300 300"/>
    <motor name="other" joint="spare"/>
  </actuator>
  <equality><joint joint1="spare"/></equality>
</mujoco>
"""
LEVEL = ARM.replace(' euler="0.3 0 0.4"', "")


def spec(low=-0.8, high=0.6, ref=0.0, text=ARM):
    return mujoco.MjSpec.from_string(text.format(low=low, high=high, ref=ref))


@pytest.mark.parametrize("against", [(), ("shoulder",)])
@pytest.mark.parametrize("ref", [0.0, 0.3])
def test_length_and_lever_are_the_closed_form_over_the_range(against, ref):
    plant = attach_to_hinges(spec(ref=ref), ["shoulder"], arms={"shoulder": 0.3}, against=against)
    across, sense = HingeCylinder(0.7, 0.3), -1.0 if against else 1.0
    for angle in np.linspace(-0.7, 0.7, 9):
        plant.data.qpos[:] = -0.1 + angle, 0.0
        mujoco.mj_forward(plant.model, plant.data)
        assert plant.extensions()[0] + plant.neutral[0] == pytest.approx(
            across.length(sense * angle), rel=1e-12
        )
        arm = plant._jacobians()[2][0, 0]
        assert arm == pytest.approx(sense * across.lever(sense * angle), rel=1e-12)


def test_the_lever_arm_is_the_slope_of_the_length_and_least_at_the_ends():
    for half, arm in ((0.3, 1.0), (0.9, 0.2), (1.3, 0.05)):
        across = HingeCylinder(half, arm)
        angles = np.linspace(-half, half, 101)
        levers = across.lever(angles)
        slope = (across.length(angles + 1e-6) - across.length(angles - 1e-6)) / 2e-6
        np.testing.assert_allclose(levers, slope, rtol=1e-7)
        assert levers.min() == pytest.approx(arm * np.cos(half), rel=1e-12)
        assert levers[0] == pytest.approx(levers[-1], rel=1e-12)
        ends = across.length([-half, half])
        assert ends == pytest.approx([1.5 * across.stroke, 2.5 * across.stroke], rel=1e-12)


def test_areas_give_the_torque_of_the_motors_at_the_ends_of_the_range():
    """50 N m times 100 and the 300 N m that the second motor's force is held to."""
    oil = load_hydraulics("hardware")
    plant = attach_to_hinges(spec(), ["shoulder"], oil)
    own = plant.hydraulics.cylinder
    across = HingeCylinder(
        0.7, float(np.hypot(*[0.0, own.half_stroke[0] / 0.55 / np.sin(0.7) / 2]))
    )
    weak = own.rod_area[0] * oil.supply_pressure.si - own.cap_area[0] * oil.return_pressure.si
    assert weak * across.lever(0.7) == pytest.approx(5300.0, rel=1e-12)
    bore = plant.parameters.actuator("shoulder_cylinder")["bore_diameter"].si
    assert across.stroke / bore == pytest.approx(5.0, rel=1e-12)
    assert [plant.model.actuator(i).name for i in range(plant.model.nu)] == [
        "other",
        *plant.actuators,
    ]


@pytest.mark.parametrize("angle", [-0.5, 0.0, 0.5])
def test_a_cylinder_lifts_a_known_load_at_the_closed_form_pressure(angle):
    """Lifted slowly: Ac p_cap - Ar p_rod = m g L cos q / r(q), in motion as at rest."""
    plant = attach_to_hinges(
        spec(text=LEVEL), {"shoulder": 6e3}, arms={"shoulder": 0.3}, against=["shoulder"]
    )
    across, own = HingeCylinder(0.7, 0.3), plant.hydraulics.cylinder
    start = np.array([angle, 0.0])
    record = drive(plant, np.full((512, 1), 0.01), start=start)
    here = record["generalised_position"][:, 0]
    force = MASS * GRAVITY * REACH * np.cos(here) / across.lever(-(here + 0.1))
    pressed = (
        own.cap_area * record["cap_pressure"][:, 0] - own.rod_area * record["rod_pressure"][:, 0]
    )
    assert pressed[0] == pytest.approx(force[0], rel=1e-9)
    assert here[-1] < angle - 5e-4
    assert pressed[-64:].mean() == pytest.approx(force[-64:].mean(), rel=0.01)


@pytest.mark.parametrize(
    ("hinges", "how", "said"),
    [
        (["elbow"], {}, "hinges: 'elbow' is not one of the hinges shoulder"),
        (["spare"], {}, "hinges: 'spare' is not one of the hinges shoulder"),
        ("shoulder", {}, "hinges: 'shoulder' names no hinges; allowed: a list"),
        ({"shoulder": -1.0}, {}, "shoulder: a torque of -1.0 N m is refused; allowed: above 0"),
        (["shoulder"], {"arms": {"elbow": 1.0}}, "arms: 'elbow' is not one of shoulder"),
        (
            ["shoulder"],
            {"arms": {"shoulder": 2.0}},
            r"arms: shoulder 2.0 m .* allowed: 0\.1598 to 0\.5277 m",
        ),
    ],
)
def test_what_no_cylinder_fits_is_refused(hinges, how, said):
    with pytest.raises(InputError, match=said):
        attach_to_hinges(spec(), hinges, **how)


def test_every_hinge_named_gets_its_own_cylinder():
    second = '<body><joint name="elbow" axis="1 0 0" range="-1 1"/><geom size="0.1"/></body></body>'
    pair = ARM.replace("</body>", second, 1).replace("<motor", '<motor joint="elbow"/><motor', 1)
    plant = attach_to_hinges(spec(text=pair), {"elbow": 50.0, "shoulder": None})
    assert plant.actuators == ("elbow_cylinder", "shoulder_cylinder")
    assert plant.model.nu == 3
    areas = plant.hydraulics.cylinder.rod_area
    assert areas[1] > areas[0]


def test_hinges_without_torque_or_with_too_wide_a_range_are_refused():
    with pytest.raises(
        InputError, match="shoulder: a range of 171.9 deg is refused; allowed: .*150"
    ):
        attach_to_hinges(spec(-1.5, 1.5), ["shoulder"])
    for arm in (0.16, 0.5276):  # the ends that the refusal above names
        attach_to_hinges(spec(), ["shoulder"], arms={"shoulder": arm})
    bare = ARM.replace('ctrlrange="-40 100"', "")
    with pytest.raises(InputError, match="shoulder: has no motor of limited torque"):
        attach_to_hinges(spec(text=bare), ["shoulder"])


def test_key_frames_keep_the_controls_of_the_actuators_that_stay():
    keys = '<keyframe><key ctrl="1 2 3" qpos="0.1 0.2"/><key/></keyframe></mujoco>'
    model = attach_to_hinges(spec(text=ARM.replace("</mujoco>", keys)), ["shoulder"]).model
    assert [model.actuator(i).name for i in range(2)] == ["other", "shoulder_cylinder"]
    assert model.key_ctrl.tolist() == [[3.0, 0.0], [0.0, 0.0]]
    assert model.key_qpos[0].tolist() == [0.1, 0.2]


def test_a_second_joint_and_names_that_are_taken_are_refused():
    joint = '<joint type="slide" axis="1 0 0"/><inertial'
    with pytest.raises(InputError, match="shoulder: its body moves by other joints too"):
        attach_to_hinges(spec(text=ARM.replace("<inertial", joint, 1)), ["shoulder"])
    spring = '<fixed name="shoulder_cylinder"><joint joint="spare" coef="1"/></fixed>'
    for name, before, own in (
        ("shoulder_parent", "<inertial", '<site name="shoulder_parent"/>'),
        ("shoulder_child", "<inertial", '<site name="shoulder_child"/>'),
        ("shoulder_cylinder", "<equality>", f"<tendon>{spring}</tendon>"),
    ):
        taken = ARM.replace(before, own + before, 1)
        with pytest.raises(InputError, match=f"shoulder: the name '{name}' is taken already"):
            attach_to_hinges(spec(text=taken), ["shoulder"])
