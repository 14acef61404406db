"""Cylinders on named joints and tendons of any model: what is refused, built, and moved."""

import mujoco
import numpy as np
import pytest
from hydraulic_equations import changed
from scipy import optimize

from cmf_mj import attach_hydraulics, drive, simulate

GRAVITY = 9.81  #: MuJoCo's default.
HALF = 0.9652  #: Half stroke of the hardware set, 38 in [m].

LIFT = """
<mujoco model="lift">
  <worldbody>
    <body>
      <joint name="ram" type="slide" axis="0 0 1" range="0 1.9304" ref="0.5"/>
      <geom type="box" size="0.5 0.5 0.1" mass="3000"/>
    </body>
  </worldbody>
</mujoco>
"""

MIXED = """
<mujoco model="mixed">
  <option integrator="{integrator}"/>
  <default><general gear="50"/><motor gear="50" ctrlrange="-1 1" forcerange="-1 1"/></default>
  <worldbody>
    <site name="hook" pos="0 0 3"/>
    <body name="load">
      <joint name="ram" type="slide" axis="0 0 1"/>
      <geom size="0.1"/>
      <site name="eye"/>
    </body>
    <body name="others">
      <joint name="wide" type="slide" axis="1 0 0" range="-1 1"/>
      <joint name="driven" type="slide" axis="0 1 0" range="-0.9 0.9"/>
      <joint name="far" type="slide" axis="1 1 0" range="-0.9 0.9" ref="1"/>
      <joint name="turn" type="hinge"/>
      <geom size="0.1"/>
      <body>
        <joint name="weak" type="slide" axis="0 1 0" range="-0.9 0.9" actuatorfrcrange="-1 1"/>
        <joint name="twin" type="slide" axis="1 0 0"/>
        <geom size="0.1"/>
      </body>
    </body>
  </worldbody>
  <tendon>
    <spatial name="rope"><site site="hook"/><site site="eye"/></spatial>
    <spatial name="twin"><site site="hook"/><site site="eye"/></spatial>
  </tendon>
  <actuator><position name="servo" joint="driven"/></actuator>
</mujoco>
"""


def spec(text=LIFT):
    return mujoco.MjSpec.from_string(text)


def mixed(integrator="Euler"):
    return spec(MIXED.format(integrator=integrator))


# Refusals


@pytest.mark.parametrize(
    ("cylinders", "said"),
    [
        (["boom"], "cylinders: 'boom' is not one of the slide joints (driven, far, ram, twin, "),
        (["boom"], "or tendons (rope, twin)"),
        (["turn"], "'turn' is a hinge joint; a cylinder needs a slide joint or a tendon"),
        (["twin"], "'twin' is a joint and a tendon; rename one"),
        (["driven"], "'driven' has the actuator 'servo' already; remove it"),
        (["ram"], "'ram' has no range; give the cylinder's retracted length"),
        (["wide"], "'wide' ranges from -1.0000 to 1.0000 m"),
        (["wide"], "from -0.9652 to 0.9652 m only"),
        ({"wide": -0.9}, "from -0.9000 to 1.0304 m only"),
        ({"wide": -1.03}, "from -1.0300 to 0.9004 m only"),
        (["far"], "'far' starts at a length of 1.0000 m; allowed: -0.9652 to 0.9652 m"),
        (["weak"], "'weak' must have no forcerange and no actuatorfrcrange"),
        ({"ram": float("nan")}, "'ram': nan m must be a finite retracted length"),
        ({"ram": 0.1}, "'ram' starts at a length of 0.0000 m; allowed: 0.1000 to 2.0304 m"),
        ({"rope": 3.5}, "'rope' starts at a length of 3.0000 m; allowed: 3.5000 to 5.4304 m"),
        ([], "names no joints or tendons"),
        ("ram", "'ram' names no joints or tendons"),
        (None, "None names no joints or tendons"),
    ],
)
def test_cylinders_that_do_not_fit_are_named(cylinders, said):
    with pytest.raises(ValueError) as refused:
        attach_hydraulics(mixed(), cylinders)
    assert said in str(refused.value)


def test_a_step_an_integrator_a_body_and_a_file_that_cannot_be_used_are_named(tmp_path):
    with pytest.raises(ValueError, match="integrator: RK4 cannot take its step in two halves"):
        attach_hydraulics(mixed("RK4"), {"ram": -0.5})
    for step in (0.0, np.inf):
        with pytest.raises(ValueError, match=f"timestep: {step} s must be greater than 0"):
            attach_hydraulics(spec(), ["ram"], timestep=step)
    with pytest.raises(ValueError, match="payload: 'cargo' is not one of load, others, world"):
        attach_hydraulics(mixed(), {"ram": -0.5}, payload=["cargo"])
    with pytest.raises(ValueError, match="model: .*none.xml cannot be read"):
        attach_hydraulics(tmp_path / "none.xml", ["ram"])
    own = tmp_path / "own.toml"
    own.write_text(
        'base = "hardware"\n[own.actuators.arm]\n'
        'half_stroke = { value = 1, unit = "m", status = "assumed", source = "test" }\n'
    )
    with pytest.raises(ValueError, match="actuators: 'arm' is not an actuator; allowed: ram"):
        attach_hydraulics(spec(), ["ram"], own)


def test_the_length_at_half_stroke_is_one_number_a_motor():
    plant = attach_hydraulics(spec(), ["ram"])
    for wrong in ([0.0, 1.0], 0.5, [np.inf]):
        with pytest.raises(ValueError, match="neutral"):
            type(plant)(plant.model, neutral=wrong)


# What is built


def test_the_middle_of_the_range_or_the_retracted_length_is_half_stroke(tmp_path):
    file = tmp_path / "lift.xml"
    file.write_text(LIFT)
    own = spec()
    for model in (file, str(file), own):
        plant = attach_hydraulics(model, ["ram"])
        assert plant.name == "lift"
        assert plant.neutral == pytest.approx([HALF], abs=1e-12)
        assert plant.extensions() == pytest.approx([0.5 - HALF], abs=1e-12)
    assert len(own.actuators) == 0
    assert own.option.timestep == 0.002
    plant = attach_hydraulics(own, {"ram": 0.0})
    assert plant.neutral == pytest.approx([HALF], abs=1e-12)
    narrow = spec(LIFT.replace("0 1.9304", "0.2 0.7"))
    assert attach_hydraulics(narrow, {"ram": -0.3}).neutral == pytest.approx([HALF - 0.3])


def test_a_joint_without_range_gets_the_stroke_and_an_actuator_nothing_of_the_defaults():
    plant = attach_hydraulics(mixed(), {"ram": -0.4, "rope": 2.5})
    assert plant.actuators == ("ram", "rope")
    model = plant.model
    assert model.opt.timestep == 1 / 2048
    assert model.joint("ram").range == pytest.approx([-0.4, 2 * HALF - 0.4])
    rope = model.tendon("rope").id
    assert model.tendon_range[rope] == pytest.approx([2.5, 2.5 + 2 * HALF])
    assert model.tendon_limited[rope]
    assert model.tendon_solref_lim[rope] == pytest.approx([0.01, 1.0])
    for name in plant.actuators:
        motor = model.actuator(name)
        assert motor.gear == pytest.approx(np.eye(6)[0])
        assert not motor.forcelimited[0]
    assert model.actuator("servo").gear[0] == 50.0


def test_the_hydraulics_of_each_cylinder_follow_its_name(tmp_path):
    own = tmp_path / "own.toml"
    own.write_text(
        'base = "hardware"\n[own.actuators.rope]\n'
        'half_stroke = { value = 400, unit = "mm", status = "assumed", source = "test" }\n'
    )
    plant = attach_hydraulics(mixed(), {"rope": 2.7, "ram": -0.4}, own)
    assert plant.hydraulics.cylinder.half_stroke == pytest.approx([0.4, HALF])
    assert plant.neutral == pytest.approx([3.1, HALF - 0.4])


# What it does


def test_a_slanted_tendon_carries_the_load_over_the_cosine():
    text = """
    <mujoco><worldbody>
      <site name="hook" pos="1.2 0 1.6"/>
      <body><joint type="slide" axis="0 0 1"/><geom size="0.1" mass="500"/><site name="eye"/></body>
    </worldbody>
    <tendon><spatial name="rope"><site site="hook"/><site site="eye"/></spatial></tendon></mujoco>
    """
    plant = attach_hydraulics(spec(text), {"rope": 1.5}, changed("hardware", leak_rate=0.0))
    weight = 500.0 * GRAVITY
    assert plant.static_load() == pytest.approx([-weight / 0.8], rel=1e-12)
    record = drive(plant, np.zeros((2048, 1)))
    assert np.abs(record["leg_extension"] - record["leg_extension"][0]).max() < 1e-9


def test_a_load_is_shared_by_parallel_cylinders_and_a_hanging_load_is_carried():
    text = """
    <mujoco><worldbody>
      <body>
        <joint type="slide" axis="0 0 1"/><geom size="0.1" mass="800"/>
        <site name="left" pos="-1 0 0"/><site name="right" pos="1 0 0"/>
        <body pos="0 0 -1">
          <joint type="hinge" axis="0 1 0" pos="0 0 0.8"/><geom size="0.1" mass="200"/>
        </body>
      </body>
      <site name="foot_left" pos="-1 0 -2"/><site name="foot_right" pos="1 0 -2"/>
    </worldbody>
    <tendon>
      <spatial name="a"><site site="foot_left"/><site site="left"/></spatial>
      <spatial name="b"><site site="foot_right"/><site site="right"/></spatial>
    </tendon></mujoco>
    """
    plant = attach_hydraulics(spec(text), {"a": 1.2, "b": 1.2})
    share = 0.5 * 1000.0 * GRAVITY
    assert plant.static_load() == pytest.approx([share, share], rel=1e-9)
    with pytest.raises(ValueError, match="2 cylinders do not determine the machine's 2 free"):
        plant.leg_motion()
    record = drive(plant, np.zeros((2048, 2)))
    assert np.abs(record["leg_extension"] - record["leg_extension"][0]).max() < 1e-9


def test_what_springs_and_other_actuators_hold_is_taken_off_the_load():
    text = """
    <mujoco><worldbody><body>
      <joint name="ram" type="slide" axis="0 0 1" range="-0.9 0.9"
             stiffness="2000" springref="0.4"/>
      <geom size="0.1" mass="800"/><site name="top"/>
    </body><site name="hook" pos="0 0 2"/></worldbody>
    <tendon><spatial name="rope"><site site="hook"/><site site="top"/></spatial></tendon>
    <actuator><general tendon="rope" biastype="affine" biasprm="-1500 0 0"/></actuator></mujoco>
    """
    plant = attach_hydraulics(spec(text), ["ram"], changed("hardware", leak_rate=0.0))
    held = 2000.0 * 0.4 + 1500.0
    assert plant.static_load() == pytest.approx([800.0 * GRAVITY - held], rel=1e-12)
    record = drive(plant, np.zeros((1024, 1)))
    assert np.abs(record["leg_extension"] - record["leg_extension"][0]).max() < 1e-9


def test_the_lift_rises_at_the_speed_of_its_orifices():
    """Both chambers take in or give off A v of oil under pressure, no leakage.

    v exp(p_cap / beta) = k u sqrt(Ps - p_cap), v exp(p_rod / beta) = k u sqrt(p_rod - Pt),
    A_cap p_cap - A_rod p_rod = W, and k u sqrt((Ps - Pt) / 2) is u times the leg speed in oil of
    mid pressure.
    """
    hydraulics = changed("report", leak_rate=0.0)
    plant = attach_hydraulics(spec(), ["ram"], hydraulics)
    cap, rod = hydraulics.cap_area, hydraulics.rod_area
    supply, weight = hydraulics.supply_pressure.si, 3000.0 * GRAVITY
    beta = hydraulics.bulk_modulus.si

    def excess(rod_pressure):
        cap_pressure = (weight + rod * rod_pressure) / cap
        return np.sqrt(supply - cap_pressure) / np.exp(cap_pressure / beta) - np.sqrt(
            rod_pressure
        ) / np.exp(rod_pressure / beta)

    rod_pressure = optimize.brentq(excess, 0.0, 0.9 * supply)
    gain = hydraulics.leg_speed.si / np.sqrt(0.5 * supply) * np.exp(0.5 * supply / beta)
    for opening in (0.2, 0.4):
        record = drive(plant, np.full((4096, 1), opening))
        speed = gain * opening * np.sqrt(rod_pressure) / np.exp(rod_pressure / beta)
        assert record["leg_velocity"][-1] == pytest.approx([speed], rel=5e-4)
        assert record["rod_pressure"][-1] == pytest.approx([rod_pressure], rel=5e-4)


def test_the_lift_obeys_a_law_and_stops_at_its_ends():
    plant = attach_hydraulics(spec(), ["ram"])
    target = np.full((8192, 1), 0.2)
    record = simulate(
        plant, "velocity_integral", target, legs=True, start=plant.configuration([0.1])
    )
    assert record["leg_extension"][0] == pytest.approx([0.1], abs=1e-9)
    assert record["leg_extension"][-1] == pytest.approx([0.2], abs=2e-3)
    for lever in (-1.0, 1.0):
        record = drive(plant, np.full((8192, 1), lever))
        assert record["leg_extension"][-1] == pytest.approx([lever * HALF], abs=5e-3)
    assert plant.data.warning.number.sum() == 0


def test_a_configuration_is_refused_beyond_the_stroke_and_of_another_shape():
    plant = attach_hydraulics(spec(), ["ram"])
    with pytest.raises(ValueError, match="extensions: ram at 1.0000 m; allowed: .-0.9652 m"):
        plant.configuration([1.0])
    with pytest.raises(ValueError, match=r"extensions: shape is \(2,\); allowed: \(1,\)"):
        plant.configuration([0.0, 0.0])
    text = """
    <mujoco><worldbody>
      <site name="hook" pos="2 0 1.5"/>
      <body><joint type="slide" axis="0 0 1"/><geom size="0.1"/><site name="eye"/></body>
    </worldbody>
    <tendon><spatial name="rope"><site site="hook"/><site site="eye"/></spatial></tendon></mujoco>
    """
    plant = attach_hydraulics(spec(text), {"rope": 1.0})
    assert plant.configuration([2.1 - 1.0 - HALF]) == pytest.approx(1.5 - np.sqrt(2.1**2 - 4.0))
    with pytest.raises(ValueError, match="the machine cannot be closed at"):
        plant.configuration([1.9 - 1.0 - HALF])
