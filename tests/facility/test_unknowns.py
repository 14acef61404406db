"""Unknowns: distributions and samplers against closed forms, what they change, what is refused."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy import stats

from cmf_mj import Hexapod, attach_hydraulics, load_cab, load_hydraulics, load_law, load_machine
from cmf_mj.control.feedback import LegFeedback
from cmf_mj.core.errors import InputError
from cmf_mj.core.settings import validated
from cmf_mj.core.units import FRAME
from cmf_mj.electronics.sensors import load_sensors, make_sensors, sense_history
from cmf_mj.facility.unknown import LEGS, LIMIT, Unknown
from cmf_mj.facility.unknowns import Unknowns, cube, load_unknowns
from cmf_mj.plant.parameters import OF_THE_SUPPLY, HydraulicParameters

HARDWARE, GFD = load_hydraulics("hardware"), load_cab("gfd")
LEAKS, FLOWS = "hydraulics.actuators.*.leak_rate", "hydraulics.actuators.*.valve_*.valve_flow"
OFFSET = {"effect": "offset"}
BETWEEN = {"low": 0.5, "high": 2.0, "unit": "1"}


def unknown(path: str = LEAKS, **changes: Any) -> Unknown:
    known = {} if "low" in changes else {"distribution": "normal", "deviation": 5.0}
    return Unknown.model_validate({"path": path, "source": "test", **known} | changes)


def values(drawn: HydraulicParameters, field: str, valve: int | None = None) -> np.ndarray:
    return np.array([drawn.actuator(name, valve)[field].si for name in LEGS])


@pytest.mark.parametrize(
    ("distribution", "sd"),
    [
        ("normal", 0.05 * np.sqrt(stats.truncnorm.var(-LIMIT, LIMIT))),
        ("uniform", 0.05 / np.sqrt(3.0)),
    ],
)
def test_samples_have_the_deviation_and_the_bounds_they_say(distribution: str, sd: float) -> None:
    """Standard deviations in closed form, within four of the standard errors."""
    points = np.random.default_rng(1).random(20000)
    sample = unknown(distribution=distribution).at(points) - 1.0
    assert np.std(sample) == pytest.approx(sd, rel=4.0 / np.sqrt(2.0 * 20000))
    assert abs(sample.mean()) < 4.0 * sd / np.sqrt(20000)
    assert np.abs(sample).max() <= (0.05 if distribution == "uniform" else LIMIT * 0.05) + 1e-15


def test_a_lognormal_factor_is_as_often_doubled_as_halved() -> None:
    points = np.random.default_rng(1).random(20001)
    sample = unknown(distribution="lognormal", deviation=30.0).at(points)
    assert np.median(sample) == pytest.approx(1.0, abs=0.02)
    assert np.abs(np.log(sample)).max() <= LIMIT * 0.3 + 1e-12


def test_bounds_are_reached_evenly_or_by_the_same_ratio() -> None:
    shares = [0.0, 0.25, 0.5, 1.0]
    assert unknown(**BETWEEN).at(shares).tolist() == [0.5, 0.875, 1.25, 2.0]
    log = unknown(**BETWEEN, distribution="loguniform").at(shares)
    assert log == pytest.approx([0.5, 0.5 * np.sqrt(2.0), 1.0, 2.0], rel=1e-15)
    inches = unknown("cab.centre_of_mass.z", low=-1.0, high=3.0, unit="in", effect="offset")
    assert inches.at(0.5) == pytest.approx(0.0254)


def test_samplers_fill_the_cube() -> None:
    """One point a stratum of a hypercube, one half of Sobol's in each half, every corner once."""
    hyper = cube("latin_hypercube", 16, 3, seed=1)
    assert (np.sort(np.floor(16.0 * hyper), axis=0).T == np.arange(16)).all()
    assert (np.sum(cube("sobol", 64, 3, seed=1) < 0.5, axis=0) == 32).all()
    assert len({tuple(corner) for corner in cube("corners", 8, 3, seed=1)}) == 8
    some = cube("corners", 5, 40, seed=1)
    assert some.shape == (5, 40) and set(np.unique(some)) == {0.0, 1.0}
    for name in ("random", "sobol", "latin_hypercube", "corners"):
        assert (cube(name, 4, 2, seed=3) == cube(name, 4, 2, seed=3)).all()
    assert Unknowns().draw("random", 2, seed=1) == [{}, {}]


def test_a_machine_drawn_is_the_same_with_more_unknowns() -> None:
    few = Unknowns(leak_rate=unknown())
    more = Unknowns(valve_flow=unknown(FLOWS), leak_rate=unknown())
    one, again, other = (few.apply(few.streams(7, draw), HARDWARE) for draw in (3, 3, 4))
    assert one == again
    assert not np.allclose(values(one, "leak_rate"), values(other, "leak_rate"))
    both = more.apply(more.streams(7, 3), HARDWARE)
    assert values(both, "leak_rate").tobytes() == values(one, "leak_rate").tobytes()
    assert len(set(values(both, "valve_flow", 0)) | set(values(both, "valve_flow", 1))) == 12
    assert len(set(values(one, "valve_flow", 0))) == 1
    assert len(set(Hexapod("gfd", one).hydraulics.cylinder.leakage)) == 6


def test_an_offset_is_added_to_a_bias_of_nothing() -> None:
    path = "hydraulics.actuators.*.valve_*.null_bias"
    biased = Unknowns(null_bias=unknown(path, effect="offset", deviation=1.0))
    bias = values(biased.apply(biased.streams(0, 0), HARDWARE), "null_bias", 1)
    assert 0.0 < np.abs(bias).max() <= 0.02
    assert (bias < 0.0).any()


def test_numbers_that_belong_together_change_together() -> None:
    """Speed goes with the root of the supply, leak rate with the oil, relief with the supply."""
    paths = {
        "supply": "hydraulics.supply",
        "oil": "hydraulics.bulk_modulus",
        "gain": "hydraulics.actuators.*.valve_gain",
        "leak": "hydraulics.actuators.leg_3.leakage",
    }
    together = Unknowns({name: unknown(path) for name, path in paths.items()})
    given = {"supply": 1.21, "oil": 0.8, "gain": np.arange(1.0, 7.0), "leak": 2.0}
    changed = together.apply(given, HARDWARE, "mine")
    assert changed.name == "mine"
    for name in ("supply_pressure", *OF_THE_SUPPLY):
        assert getattr(changed, name).si == pytest.approx(1.21 * getattr(HARDWARE, name).si)
    assert changed.bulk_modulus.si == pytest.approx(0.8 * HARDWARE.bulk_modulus.si)
    faster = values(changed, "leg_speed") / HARDWARE.leg_speed.si
    assert faster == pytest.approx(1.1 * np.arange(1.0, 7.0))
    leaks = values(changed, "leak_rate") / HARDWARE.leak_rate.si
    assert leaks == pytest.approx([1.0, 1.0, 1.6, 1.0, 1.0, 1.0])


def test_masses_of_a_cab_change_as_their_paths_say() -> None:
    paths = ("cab.mass", "cab.inertia", "cab.density", "payload.density", "platform.mass")
    each = {path: Unknowns(x=unknown(path)).apply({"x": 1.5}, GFD) for path in paths}
    found = {
        path: (one.mass.si / GFD.mass.si, one.tensor[1, 1] / GFD.tensor[1, 1])
        for path, one in each.items()
    }
    assert found["cab.mass"] == found["cab.density"] == pytest.approx((1.5, 1.5))
    assert found["cab.inertia"] == pytest.approx((1.0, 1.5))
    alone = Unknowns(mass=unknown("cab.mass"), inertia=unknown("cab.inertia"))
    heavy = alone.apply({"mass": 1.5, "inertia": 1.0}, GFD)
    assert heavy.mass.si == 1.5 * GFD.mass.si and (heavy.tensor == GFD.tensor).all()
    assert each["payload.density"].payload.mass == pytest.approx(1.5 * GFD.payload.mass)
    assert each["payload.density"].payload.inertia == pytest.approx(1.5 * GFD.payload.inertia)
    assert each["platform.mass"].platform.mass.si == 1.5 * GFD.platform.mass.si
    assert each["cab.mass"].assumed == GFD
    moved = Unknowns(place=unknown("cab.centre_of_mass", effect="offset", deviation=0.1, unit="m"))
    place = moved.apply({"place": np.array([0.1, 0.0, -0.2])}, GFD).centre_of_mass.si
    assert place - GFD.centre_of_mass.si == pytest.approx([0.1, 0.0, -0.2])


def test_numbers_of_law_machine_and_sensors_change_by_path() -> None:
    law, machine, ideal = load_law("velocity"), load_machine("simona"), load_sensors("ideal")
    pole = unknown("law.derivative_pole", low=75.0, high=105.0, unit="rad/s", effect="value")
    changed = Unknowns(
        pole=pole,
        gain=unknown("law.direct_gain.velocity"),
        stroke=unknown("machine.legs.half_stroke"),
        bias=unknown("electronics.leg_velocity.gain_errors.2", effect="offset"),
    )
    given = {"pole": 90.0, "gain": 2.0, "stroke": 1.1, "bias": 0.01}
    other = changed.apply(given, law)
    assert other.derivative_pole == 90.0
    assert other.direct_gain.velocity == 2.0 * law.direct_gain.velocity
    longer = changed.apply(given, machine, "longer")
    assert longer.legs.half_stroke.si == pytest.approx(1.1 * machine.legs.half_stroke.si)
    errors = changed.apply(given, ideal).leg_velocity.gain_errors
    assert [one.si for one in errors] == [0.0, 0.01, 0.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"path": "luck"}, "path: 'luck' is refused"),
        ({"path": "hydraulics.actuators.*.pump_flow"}, "path: .*pump_flow' is refused"),
        ({"path": "hydraulics.actuators.*.valve_*.leak_rate"}, "path: .*leak_rate' is refused"),
        ({"path": "electronics.leg_jerk.bias"}, "path: 'electronics.leg_jerk.bias' is refused"),
        ({"path": "cab.density", "effect": "offset"}, "effect: 'offset' is refused"),
        ({"effect": "value"}, "deviation: goes with"),
        ({"distribution": "loguniform"}, "deviation: goes with"),
        ({"low": 1.0}, "deviation: goes with"),
        ({"deviation": 100.0, "distribution": "uniform"}, "deviation: 100 % must be less than 1"),
        ({"deviation": 0.0}, "deviation"),
        ({"deviation": None}, "deviation: goes with"),
        ({"deviation": None, "distribution": "uniform"}, "None to None is refused"),
        (BETWEEN | {"deviation": None, "distribution": "uniform", "low": 9.0}, "9.0 to .* refused"),
        (BETWEEN | {"deviation": None, "distribution": "loguniform", "low": 0.0}, "0.0 to .* ref"),
        ({"unit": "furlong"}, "'furlong'"),
        (BETWEEN | {"deviation": None, "distribution": "uniform", "unit": "%"}, "must be '1'"),
        ({"deviation": 50.0}, "deviation: 50 % must be less than 0.5"),
        ({"deviation": 0.2, "unit": "m"}, "unit: 'm' of a factor's deviation must be % or 1"),
        (OFFSET | {"path": "cab.mass", "unit": "psi"}, "unit: 'psi' .* cab.mass: kg, lbm"),
        (OFFSET | {"path": "cab.centre_of_mass.z"}, "unit: '%' is refused"),
        (OFFSET | {"path": "hydraulics.bore_diameter", "unit": "s"}, "unit: 's' is refused"),
        (OFFSET | {"path": "cab.mass", "distribution": "lognormal"}, "goes with the effect factor"),
        ({"source": ""}, "source"),
    ],
)
def test_what_cannot_be_unknown_is_refused(changes: dict[str, Any], message: str) -> None:
    table = {"path": LEAKS, "source": "test", "distribution": "normal", "deviation": 5.0}
    with pytest.raises(ValueError, match=message):
        validated(Unknown, table | changes, "test")


def test_quantities_that_sound_like_factors_are_quantities() -> None:
    """Leakage of bearings, density of oil; a lognormal factor of any width is positive."""
    leak = {"low": 0.0, "high": 1e-3, "unit": "gpm/psi", "effect": "value"}
    assert unknown("hydraulics.bearing_leakage", **leak).at(0.5) == 5e-4
    dense = {"low": 800.0, "high": 900.0, "unit": "kg/m^3", "effect": "value"}
    assert unknown("hydraulics.oil_density", **dense).at(0.5) == 850.0
    assert unknown(distribution="lognormal", deviation=120.0).at(1e-9) > 0.0


def test_numbers_that_a_part_does_not_give_are_refused() -> None:
    for path, part, message in (
        ("law.modes.gfd", load_law("velocity"), "law.modes.gfd: is not a number that is given"),
        ("electronics.leg_velocity.bias", load_sensors("ideal"), "is not a number that is given"),
        ("machine.title", load_machine(), "machine.title: is not a number that is given"),
    ):
        with pytest.raises(ValueError, match=message):
            Unknowns(x=unknown(path)).apply({"x": 1.1}, part)
    with pytest.raises(ValueError, match="row: 'x' is not one of y"):
        Unknowns(x=unknown()).of({"y": 1.0})


def test_what_all_have_in_common_changes_before_what_each_has() -> None:
    every = unknown("hydraulics.leg_speed", **BETWEEN, effect="factor")
    each = unknown("hydraulics.actuators.*.leg_speed", **BETWEEN, effect="factor")
    factors = np.linspace(0.9, 1.1, 6)
    drawn = Unknowns({"each": each, "every": every}).apply(
        {"each": factors, "every": 1.2}, HARDWARE
    )
    expected = 1.2 * factors * HARDWARE.leg_speed.si
    np.testing.assert_allclose(values(drawn, "leg_speed"), expected, rtol=1e-12)
    known = {p: unknown(f"cab.{p}", **BETWEEN) for p in ("inertia", "second_moment.x")}
    with pytest.raises(ValueError, match=r"cab\.inertia: allowed: it or second moments"):
        Unknowns(known).apply(dict.fromkeys(known, 1.1), GFD)


def test_all_that_is_wrong_in_a_file_is_said_at_once(tmp_path: Path) -> None:
    table = 'path = "luck"\nlow = 1.0\nhigh = 2.0\nsource = "test"\n'
    file = tmp_path / "mine.toml"
    file.write_text(f'[unknowns.one]\n{table}[unknowns.two]\n{table}sauce = "x"\n[study]\n')
    with pytest.raises(InputError) as refused:
        load_unknowns(file)
    assert load_unknowns("valve_gains").keys() == {"leg_speed"}
    with pytest.raises(ValueError, match="unknowns: 'none' is not one of valve_gains"):
        load_unknowns("none")
    first, second = str(refused.value).splitlines()
    assert first.startswith("mine.toml: unknowns.one: path: 'luck' is refused")
    assert second.startswith("mine.toml: unknowns.two.sauce: is not a known field")


BALANCE = """
<mujoco model="balance">
  <worldbody>
    <body name="load"><joint name="ram" type="slide" axis="0 0 1" range="0 1.9304"/>
      <geom name="box" type="box" size="0.5 0.5 0.1" mass="3000"/></body>
    <body name="other" pos="2 0 0"><joint name="side" type="slide" axis="0 0 1" range="0 1.9304"/>
      <geom type="box" size="0.5 0.5 0.1" mass="1000"/></body>
  </worldbody>
</mujoco>
"""


def test_any_plant_is_drawn_with_its_own_actuators_and_masses() -> None:
    """Drawn weights are what the cylinders carry; the plant drawn from stays as it was."""
    plant = attach_hydraulics(mujoco.MjSpec.from_string(BALANCE), ["ram", "side"])
    each = Unknowns(
        mass=unknown("model.body.load.mass"),
        leak=unknown(),
        bias=unknown(FLOWS),
        drag=unknown("model.joint.side.damping", effect="value", low=5.0, high=6.0, unit="1"),
        speed=unknown("hydraulics.actuators.side.leg_speed"),
    )
    drawn = each.on(plant).streams(3, 1)
    assert drawn["leak"].shape == (2,) and drawn["bias"].shape == (2, 2)
    made = each.apply(drawn, plant)
    assert made.static_load() == pytest.approx([3000.0 * 9.81 * drawn["mass"], 9810.0], rel=1e-12)
    assert plant.static_load() == pytest.approx([3000.0 * 9.81, 9810.0], rel=1e-12)
    ratio = made.model.body("load").inertia / plant.model.body("load").inertia
    np.testing.assert_allclose(ratio, drawn["mass"], rtol=1e-12)
    assert 5.0 <= made.model.joint("side").damping[0] <= 6.0
    speeds = [made.parameters.actuator(name)["leg_speed"].si for name in plant.actuators]
    assert speeds[1] / speeds[0] == pytest.approx(drawn["speed"])
    assert made.digest != plant.digest
    again = each.apply(drawn, plant)
    assert again.digest == made.digest and again.parameters == made.parameters
    with pytest.raises(ValueError, match="model.body.lead.mass: .*lead"):
        Unknowns(x=unknown("model.body.lead.mass")).apply({"x": 1.1}, plant)


def test_a_motion_base_is_drawn_with_its_cab() -> None:
    heavy = Unknowns(mass=unknown("cab.mass"), gain=unknown("hydraulics.leg_speed"))
    made = heavy.apply({"mass": 1.2, "gain": 0.9}, Hexapod("rfd"))
    cab = load_cab("rfd")
    assert made.cab_parameters.mass.si == pytest.approx(1.2 * cab.mass.si)
    assert made.parameters.leg_speed.si == pytest.approx(0.9 * HARDWARE.leg_speed.si)
    assert made.law_key == cab


def sensors_with(errors: np.ndarray) -> Any:
    gains = Unknowns(gain=unknown("electronics.leg_velocity.gain_errors.*", effect="offset"))
    return make_sensors(gains.apply({"gain": errors}, load_sensors("ideal")), 1.0 / FRAME)


def test_a_sensor_with_a_gain_error_reads_in_proportion() -> None:
    errors = np.array([0.01, -0.02, 0.0, 0.03, -0.04, 0.05])
    truth = LegFeedback(*np.random.default_rng(0).normal(size=(5, 3, 6)))
    read = sense_history(sensors_with(errors), truth)
    assert read.velocity == pytest.approx(truth.velocity * (1.0 + errors), rel=1e-12)
    assert read.position.tobytes() == truth.position.tobytes()


def test_gains_that_are_not_one_a_leg_are_refused() -> None:
    with pytest.raises(ValueError, match=r"leg_velocity.gain_errors: 5 are given; allowed: 6"):
        sense_history(sensors_with(np.zeros(5)), LegFeedback(*np.zeros((5, 3, 6))))
    with pytest.raises(ValueError, match=r"gain_errors\.0: .* must be less than 1 1"):
        sensors_with(np.ones(6))
