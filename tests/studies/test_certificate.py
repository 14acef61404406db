"""Certificates: loops with parameters against linearised machines, bounds against attacks."""

from pathlib import Path

import numpy as np
import pytest
from hydraulic_equations import changed
from numpy.typing import NDArray

import cmf_mj
from cmf_mj.analysis.linear.assembly import linearize
from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.analysis.linear.loop import closed_loop
from cmf_mj.analysis.linear.poles import are_stable
from cmf_mj.analysis.linear.structured import peak_bound
from cmf_mj.analysis.modes import bound
from cmf_mj.control.law import Gains
from cmf_mj.core.errors import InputError
from cmf_mj.facility.scenario import load_scenario
from cmf_mj.facility.unknowns import Unknowns
from cmf_mj.plant.cylinder import Contact
from cmf_mj.plant.parameters import hydraulics_of
from cmf_mj.studies.certificate import QUICK, _attack, _Machine, certify, save_case
from cmf_mj.studies.certificate_box import DIMENSIONS, load_box
from cmf_mj.studies.certificate_family import REPETITIONS, Family

POSE = np.array([0.2, 0.05, -0.1, 0.03, 0.05, -0.1])
BOX = load_box()


def least_damping(
    law: cmf_mj.Law,
    plant: cmf_mj.Hexapod,
    pose: NDArray[np.float64],
    friction: Contact | None = None,
) -> float:
    """Of all poles of the loop in frames below 100 Hz."""
    poles = closed_loop(bound(law, plant), linearize(plant, pose, friction=friction)).poles()
    poles = np.log(poles[np.abs(poles) > 0.5] + 0j) / law.frame
    return float((-poles.real / np.abs(poles)).min())


@pytest.fixture(scope="module")
def plant() -> cmf_mj.Hexapod:
    return cmf_mj.Hexapod("gfd")


@pytest.mark.parametrize("name", ["velocity", "position_error_rate", "modal_plan"])
def test_nominal_loop_is_the_one_in_frames(name: str, plant: cmf_mj.Hexapod) -> None:
    law = cmf_mj.load_law(name)
    family = Family(plant, law, POSE)
    found = family.damping(np.zeros((1, sum(REPETITIONS))))[0]
    assert found == pytest.approx(least_damping(law, plant, POSE), abs=5e-5)


@pytest.mark.parametrize("kind", [*BOX.unknowns, "all"])
def test_machines_are_those_of_their_files(
    kind: str, plant: cmf_mj.Hexapod, tmp_path: Path
) -> None:
    """Each number off alone, then all at once; the files name a machine that is linearised anew."""
    point = np.random.default_rng(5).uniform(-1.0, 1.0, (1, DIMENSIONS))
    parts = Unknowns(BOX.unknowns).split(np.arange(DIMENSIONS))
    if kind != "all":
        point[:, np.delete(np.arange(DIMENSIONS), parts[kind])] = 0.0
    changes = BOX.changes(point)
    law = cmf_mj.load_law("velocity")
    save_case(tmp_path, "drawn", plant, law, POSE, BOX, changes)
    cab = cmf_mj.load_cab(tmp_path / "cab.toml")
    machine = cmf_mj.Hexapod(cab, tmp_path / "hydraulics.toml")
    exact = least_damping(cmf_mj.load_law(tmp_path / "law.toml"), machine, POSE)
    family = Family(plant, law, POSE)
    assert family.damping(family.deltas(changes))[0] == pytest.approx(exact, abs=3e-4)


@pytest.mark.parametrize("friction", ["none", "stuck", 0.05])
@pytest.mark.parametrize("name", ["lab", "simona"])
def test_other_machines_are_those_of_their_files_too(
    name: str, friction: Contact, tmp_path: Path
) -> None:
    """A machine of one's own, with dry friction. Its legs rest with open valves, whose slope with
    pressure is taken from the nominal machine: of equal areas that is worth most."""
    dry = {"coulomb_friction": (60.0, "N"), "breakaway_friction": (70.0, "N")}
    rubs = changed(hydraulics_of(cmf_mj.load_machine(name)), name="rubs", **dry)
    base = cmf_mj.load_machine(name)
    machine = base.model_copy(update={"name": "mine", "mjcf": None})
    plant, law = cmf_mj.Hexapod(cmf_mj.load_cab(None, machine), rubs), cmf_mj.load_law(base.law)
    changes = BOX.changes(np.random.default_rng(5).uniform(-1.0, 1.0, (1, DIMENSIONS)))
    path = save_case(tmp_path, "drawn", plant, law, 0.3 * POSE, BOX, changes)
    drawn, law_file = load_scenario(path).session().plant, cmf_mj.load_law(tmp_path / "law.toml")
    assert isinstance(drawn, cmf_mj.Hexapod) and drawn.machine.name == "mine"
    assert drawn.parameters.coulomb_friction.si == pytest.approx(60.0)
    exact = least_damping(law_file, drawn, 0.3 * POSE, friction)
    family = Family(plant, law, 0.3 * POSE, friction)
    left_out = 3e-4 if name == "lab" else 1e-3
    assert family.damping(family.deltas(changes))[0] == pytest.approx(exact, abs=left_out)


def test_each_leg_has_the_ports_of_its_own_cylinder() -> None:
    """One leg of another bore: the family's machine is the one that is linearised anew."""
    base = cmf_mj.load_hydraulics("report")
    wide = {"value": 1.15 * base.bore_diameter.value, "unit": base.bore_diameter.unit}
    one = {"leg_3": {"bore_diameter": wide | {"status": "assumed", "source": "a test"}}}
    plain = base.model_dump(mode="json", exclude_none=True)
    oil = type(base).model_validate(plain | {"name": "mixed", "actuators": one})
    law, light = cmf_mj.load_law("velocity"), cmf_mj.load_cab("gfd")
    values = np.zeros((1, DIMENSIONS))
    values[
        0, np.arange(DIMENSIONS)[Unknowns(BOX.unknowns).split(np.arange(DIMENSIONS))["cab_mass"]]
    ] = 1.0
    changes = BOX.changes(values)
    heavy = Unknowns(BOX.unknowns).apply(BOX.values(changes), light, "heavy")
    family = Family(cmf_mj.Hexapod(light, oil), law, np.zeros(6))
    exact = least_damping(law, cmf_mj.Hexapod(heavy, oil), np.zeros(6))
    assert family.damping(family.deltas(changes))[0] == pytest.approx(exact, abs=3e-4)


def test_a_leg_loaded_where_its_valve_begins_to_open_is_certified(tmp_path: Path) -> None:
    """Its chambers creep, which is no loss: every machine of the box, linearised, is stable."""
    sheet, law = cmf_mj.load_cab(None, "lab"), cmf_mj.load_law("original")
    mass = sheet.mass.model_copy(update={"value": 1.21 * sheet.mass.value})
    plant = cmf_mj.Hexapod(sheet.model_copy(update={"mass": mass, "name": "loaded"}))
    narrow = {
        name: one.model_copy(update={"deviation": 0.1 * one.deviation})
        for name, one in BOX.unknowns.items()
    }
    box = BOX.model_copy(update={"unknowns": narrow})
    one = certify(plant, law, tmp_path, box, QUICK._replace(poses=1), friction="none")
    assert one.proven_scale > 1.0
    closed = set[bool]()
    for point in np.random.default_rng(5).uniform(-1.0, 1.0, (6, 1, DIMENSIONS)):
        values = box.values(box.changes(point))
        cab, oil = (
            Unknowns(narrow).apply(values, part, "drawn")
            for part in (plant.cab_parameters, plant.parameters)
        )
        linear = Linear(cmf_mj.Hexapod(cab, oil), friction="none")
        assert are_stable(linear.leg_loop(law).poles())
        closed |= set(linear.point.command == 0.0)
    assert closed == {True, False}  # machines on either side


def test_box_holds_its_machines(plant: cmf_mj.Hexapod) -> None:
    """No machine of a box is wider off than the loop that stands for the box."""
    family = Family(plant, cmf_mj.load_law("velocity"), POSE)
    points = np.random.default_rng(6).uniform(-1.0, 1.0, (2000, DIMENSIONS))
    points[1000:] = np.sign(points[1000:])
    for scale in (0.3, 1.0):
        deltas = family.deltas(BOX.changes(scale * points))
        assert (np.abs(deltas) <= scale * family.widths(BOX, scale) * (1.0 + 1e-12)).all()


@pytest.mark.slow
def test_no_sample_and_no_attack_beats_the_bound(tmp_path: Path, plant: cmf_mj.Hexapod) -> None:
    effort = QUICK._replace(poses=1, samples=300)
    one = certify(plant, cmf_mj.load_law("velocity"), tmp_path, BOX, effort)
    assert 0.0 < one.proven_scale < one.breaking_scale < 1.25 * one.proven_scale
    assert all(proof.attacked > proof.ratio for proof in one.proofs)
    family = Family(plant, cmf_mj.load_law("velocity"), one.breaking_pose)
    points = np.sign(np.random.default_rng(7).uniform(-1.0, 1.0, (500, DIMENSIONS)))
    assert family.damping_in(BOX, 0.999 * one.proven_scale * points).min() > 0.0
    assert (
        one.swing_within < 0.02 < 0.2 < one.swing_beyond
    )  # the simulation rings on beyond, not within


def test_every_seed_that_the_command_takes_attacks(plant: cmf_mj.Hexapod) -> None:
    """The largest and its successors, one a start, were refused inside NumPy."""
    family = Family(plant, cmf_mj.load_law("velocity"), POSE)
    nominal = _Machine(family, np.zeros(DIMENSIONS), 0.0)
    for seed in (0, 2**32 - 2, 2**32 - 1, 2**32 + 19):
        once = QUICK._replace(rounds=1, seed=seed)
        assert np.isfinite(_attack(nominal, BOX, once, 0.1, -1.0).damping)


def test_law_that_is_unstable_as_built(tmp_path: Path) -> None:
    """Position error rate feedback with the IFD: nothing is proven, the nominal machine rings."""
    plant = cmf_mj.Hexapod("ifd")
    effort = QUICK._replace(poses=1, samples=100)
    one = certify(plant, cmf_mj.load_law("position_error_rate"), tmp_path, BOX, effort)
    assert one.nominal_damping < 0.0
    assert (one.proven_scale, one.breaking_scale, one.proofs) == (0.0, 0.0, ())
    assert one.swing_beyond > 0.5


@pytest.mark.parametrize("position", [0.0, 0.2, -0.2])
def test_a_law_that_lets_the_platform_creep_away_is_not_certified(
    position: float, tmp_path: Path, plant: cmf_mj.Hexapod
) -> None:
    """Without position feedback, or with the wrong sign: no pole is faster than 0.04 rad/s."""
    gains = Gains(velocity=-2.3, reference=-position, position=position)
    law = cmf_mj.Law(name="creeps", title="Creeps", direct_gain=gains)
    held = position < 0.0
    assert (Family(plant, law, np.zeros(6)).nominal_damping() > 0.0) == held
    if not held:
        one = certify(plant, law, tmp_path, BOX, QUICK._replace(poses=1, samples=64))
        assert (one.proven_scale, one.breaking_scale, one.proofs) == (0.0, 0.0, ())


def test_bound_of_less_is_not_asked_for(plant: cmf_mj.Hexapod) -> None:
    """A bound that is known already spares the work: `least` comes back."""
    family = Family(plant, cmf_mj.load_law("modal_plan"), np.zeros(6))
    assert peak_bound(family.widen(0.02 * family.widths(BOX, 1.0)), 0.0, 1.0) == 1.0


def test_wide_box_leaves_a_share_of_each_number() -> None:
    """Of a fit that cannot tell two lags apart, replayed at 1.5 times the largest scale."""
    lag = BOX.unknowns["drive_lag"].model_copy(update={"deviation": 60.0})
    wide = BOX.model_copy(update={"unknowns": {**BOX.unknowns, "drive_lag": lag}})
    changes = wide.changes(-1.95 * np.ones((1, DIMENSIONS)))
    assert changes["drive_lag"].min() == pytest.approx(-0.95)
    assert changes["cab_place"].min() == pytest.approx(-1.95 * BOX.unknowns["cab_place"].half)
    usual = BOX.changes(-1.95 * np.ones((1, DIMENSIONS)))
    assert usual["drive_lag"].min() == pytest.approx(-1.95 * 0.15)


def test_refused_boxes(tmp_path: Path) -> None:
    path = tmp_path / "box.toml"
    text = Path(cmf_mj.__file__).parent.joinpath("studies/certificate.toml").read_text()
    path.write_text(text.replace("deviation = 15.0", "deviation = -1.0"))
    with pytest.raises(InputError, match="drive_lag"):
        load_box(path)
