"""Many runs at once are the single runs to the bit, whatever happens to the others."""

from typing import Any

import mujoco
import numpy as np
import pytest

from cmf_mj import (
    Hexapod,
    InputError,
    RunError,
    SingleLegs,
    attach_hydraulics,
    drive,
    load_hydraulics,
    load_law,
    signals,
    simulate,
    simulate_many,
)
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.electronics.sensors import load_sensors
from cmf_mj.facility.unknown import Unknown
from cmf_mj.facility.unknowns import Unknowns
from cmf_mj.plant.plant import Plant

LAWS = ("velocity", "position_error_rate", "acceleration")


def steps(*sizes: float) -> list[signals.Command]:
    """Steps in heave [m]."""
    return [signals.step("heave", size, at=0.02, duration=0.2) for size in sizes]


def test_each_case_is_its_single_run() -> None:
    commands = steps(0.002, -0.004, 0.01)
    names = ("leg_extension", "cap_pressure", "platform_pose", "gimbal_error")
    runs = simulate_many(Hexapod("rfd"), LAWS, commands, channels=names, threads=2, record_every=8)
    for case, (law, command) in enumerate(zip(LAWS, commands, strict=True)):
        single = simulate(Hexapod("rfd"), law, command, record_every=8)
        np.testing.assert_array_equal(runs.time, single.time)
        for name in names:
            np.testing.assert_array_equal(runs[name][case], single[name])
            assert runs.units[name] == single.units[name]
    assert runs.left == ("", "", "")


def test_each_case_may_have_a_plant_of_its_own() -> None:
    masses = (2000.0, 4000.0)

    def plant(case: int) -> Plant:
        return SingleLegs(effective_mass=masses[case])

    poses = np.stack([command.pose for command in steps(0.005, 0.005)])
    runs = simulate_many(plant, "velocity", poses, record_every=16)
    for case in range(2):
        single = simulate(plant(case), "velocity", poses[case], record_every=16)
        np.testing.assert_array_equal(runs["leg_extension"][case], single["leg_extension"])
    assert not np.array_equal(*runs["leg_extension"])


def test_a_case_that_leaves_its_bounds_is_marked_and_leaves_the_others_alone() -> None:
    """Without gas in the oil a chamber that is torn open goes below vacuum."""
    oil = load_hydraulics("hardware")
    none = oil.cavitation_gas.model_copy(update={"value": 0.0})
    plant = SingleLegs(oil.model_copy(update={"cavitation_gas": none}))
    poses = np.zeros((3, 320, 6))
    poses[1, 8:, 2], poses[1, 150:, 2] = -0.9, 0.9
    runs = simulate_many(plant, "velocity", poses, record_every=64)
    assert [bool(text) for text in runs.left] == [False, True, False]
    assert "below vacuum" in runs.left[1]
    assert np.isnan(runs["leg_extension"][1]).all()
    assert np.isfinite(runs["leg_extension"][[0, 2]]).all()
    with pytest.raises(RunError, match="all 1 cases"):
        simulate_many(plant, "velocity", poses[1:2])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"law": ["velocity", "original"]}, "law: 2 for 3 cases; allowed: one, or one a case"),
        ({"channels": ()}, "allowed: at least one"),
        ({"commands": np.empty((0, 8, 6))}, "allowed: at least one"),
        ({"commands": steps(0.001) + [signals.step("heave", 0.1)]}, "commands: case 1 has shape"),
        ({"channels": ("leg_length",)}, "channel: 'leg_length' is not one of"),
        ({"threads": 0}, "jobs: 0 must be at least 1"),
    ],
)
def test_refusals(arguments: dict[str, object], message: str) -> None:
    chosen = {"law": "velocity", "commands": np.zeros((3, 8, 6))} | arguments
    with pytest.raises(InputError, match=message):
        simulate_many(SingleLegs(), **chosen)  # type: ignore[arg-type]


PRESS = """
<mujoco model="press">
  <worldbody>
    <body name="load"><joint name="ram" type="slide" axis="0 0 1" range="0 1.9304"/>
      <geom type="box" size="0.5 0.5 0.1" mass="3000"/></body>
    <body name="other" pos="2 0 0"><joint name="side" type="slide" axis="1 0 0" range="0 1.9304"/>
      <geom type="box" size="0.5 0.5 0.1" mass="1000"/></body>
  </worldbody>
</mujoco>
"""
LIKELY = Unknowns(
    mass=Unknown(path="model.body.load.mass", deviation=20.0, source="test"),
    speed=Unknown(path="hydraulics.actuators.*.leg_speed", deviation=10.0, source="test"),
    gain=Unknown(path="law.direct_gain.velocity", deviation=10.0, source="test"),
    sensor=Unknown(
        path="electronics.leg_position.gain_errors.*", deviation=1.0, effect="offset", source="test"
    ),
)
KEPT = ("leg_extension", "cap_pressure")


def press() -> Plant:
    return attach_hydraulics(mujoco.MjSpec.from_string(PRESS), ["ram", "side"])


@pytest.mark.parametrize("law", ["velocity", None])
def test_drawn_plants_of_any_model_are_their_single_runs(law: str | None) -> None:
    """Extensions under a law with noisy sensors, or valve commands without one."""
    plant, rng = press(), np.random.default_rng(2)
    tables = 0.02 * rng.uniform(-1.0, 1.0, (3, 1, 2)) * np.linspace(0.0, 1.0, 256)[:, None]
    how: dict[str, Any] = {"start": plant.configuration([0.0, 0.0]), "record_every": 16}
    how |= {} if law is None else {"legs": True}
    many = how | {"electronics": "ideal" if law is None else "inertial", "channels": KEPT}
    runs, again = (
        simulate_many(plant, law, tables, unknowns=LIKELY, seed=5, **many) for _ in range(2)
    )
    for case, table in enumerate(tables):
        own = LIKELY.on(plant)
        values = own.streams(5, case)
        drawn = own.apply(values, press())
        if law is None:
            single = drive(drawn, table, **how)
        else:
            sensors = own.apply(values, load_sensors("noisy").model_copy(update={"gravity": False}))
            chain = ElectronicsSettings(sensors=sensors, seed=5)
            with_law = own.apply(values, load_law(law))
            single = simulate(drawn, with_law, table, electronics=chain, **how)
        for name in KEPT:
            np.testing.assert_array_equal(runs[name][case], single[name])
            np.testing.assert_array_equal(runs[name][case], again[name][case])
    assert np.ptp(runs["cap_pressure"][:, 0, 0]) > 1e5


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
    with pytest.raises(InputError, match="gravity along the legs needs .* 'inertial'"):
        simulate(press(), "velocity", still[:, :2], legs=True, electronics="noisy")
