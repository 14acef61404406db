"""Machines as files: the catalogue, what a file must say, and SIMONA against published numbers."""

import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomlkit

import cmf_mj
from cmf_mj.core.settings import merged
from cmf_mj.machine import models
from cmf_mj.machine.cab import load_cab, recorded_cab
from cmf_mj.machine.geometry import paired_circles
from cmf_mj.machine.kinematics import excursion_envelope, legs_to_pose, pose_to_legs
from cmf_mj.machine.machine import Machine, load_machine, recorded_machine
from cmf_mj.machine.motion_limits import load_motion_limits

NAMES = models.machine_names()


def table_of(name: str = "lab") -> dict[str, Any]:
    text = (models.directory() / "machines" / f"{name}.toml").read_text("utf-8")
    return tomllib.loads(text) | {"name": "mine"}


def written(folder: Path, table: dict[str, Any]) -> Path:
    path = folder / "mine.toml"
    path.write_text(tomlkit.dumps(table))
    return path


def stated(value: Any, unit: str = "m") -> dict[str, Any]:
    return {"value": value, "unit": unit, "status": "assumed", "source": "test"}


# The catalogue


def test_the_catalogue_begins_with_the_cmf() -> None:
    assert NAMES[0] == "cmf" and {"simona", "lab"} <= set(NAMES)
    assert tuple(load_machine().cabs) == models.CABS


@pytest.mark.parametrize("name", NAMES[1:])
def test_a_machine_comes_back_from_json(name: str) -> None:
    """As from the metadata of a record, under a name that is not shipped."""
    machine = load_machine(name).model_copy(update={"name": "mine"})
    assert (
        recorded_machine({"machine": "mine", "machine_parameters": machine.recorded()}) == machine
    )
    assert recorded_machine({"machine": name}) is load_machine(name)


def test_simona_has_the_published_legs() -> None:
    """Legs of 2.131 to 3.281 m, 2.7061 m at neutral: height and chord of the two circles."""
    shape = load_machine("simona").geometry
    angle = np.radians(60.0) - np.arcsin(1 / 16) - np.arcsin(3 / 16.5)
    chord = 1.6**2 + 1.65**2 - 2 * 1.6 * 1.65 * np.cos(angle)
    np.testing.assert_allclose(shape.neutral, np.sqrt(2.39**2 + chord), rtol=0, atol=1e-7)
    np.testing.assert_allclose(shape.neutral, 2.7061, rtol=0, atol=5e-5)
    half = load_machine("simona").half_stroke
    assert (
        abs(shape.neutral[0] - half - 2.131) < 2e-4 and abs(shape.neutral[0] + half - 3.281) < 2e-4
    )
    pairs = np.linalg.norm(np.roll(shape.upper, -1, axis=0) - shape.upper, axis=1)[[1, 3, 5]]
    np.testing.assert_allclose(pairs, 0.2, atol=1e-7)


def test_circles_have_the_cmf_s_order_of_legs() -> None:
    """With its radii, spacings and height the gimbals are Appendix A's within their rounding."""
    cmf = load_machine().geometry
    circles = []
    for points, first in ((cmf.upper, 1), (cmf.lower, 0)):
        angle = np.arctan2(points[:, 1], points[:, 0])
        spacing = np.abs(angle[first] - angle[first + 1])
        circles.append((np.linalg.norm(points[:, :2], axis=1).mean(), spacing))
    height = cmf.lower[0, 2] - cmf.upper[0, 2]
    upper, lower = paired_circles(circles[0], circles[1], height)
    np.testing.assert_allclose(upper + [0, 0, cmf.upper[0, 2]], cmf.upper, atol=5e-4)
    np.testing.assert_allclose(lower + [0, 0, cmf.upper[0, 2]], cmf.lower, atol=5e-4)


# Kinematics and limits


@pytest.mark.parametrize("name", NAMES)
def test_poses_come_back_over_the_envelope(name: str) -> None:
    reach = np.abs(excursion_envelope(None, name)).max(axis=1)
    poses = np.random.default_rng(0).uniform(-0.3, 0.3, (200, 6)) * reach
    legs = pose_to_legs(poses, name)
    np.testing.assert_allclose(legs_to_pose(legs, name), poses, rtol=0, atol=1e-9)


def test_derived_limits_use_up_the_legs_and_no_more() -> None:
    """At each end one leg is at its stroke; at each rate one leg is at its own."""
    machine = load_machine("simona")
    limits = load_motion_limits(None, machine)
    for index, axis in enumerate(limits.axes):
        for end in (0, 1):
            pose = np.zeros(6)
            pose[index] = axis.operational.si[end]
            assert np.abs(pose_to_legs(pose, machine)).max() == pytest.approx(0.525, abs=1e-9)
        step = np.zeros(6)
        step[index] = 1e-6
        slope = (pose_to_legs(step, machine) - pose_to_legs(-step, machine)) / 2e-6
        assert np.abs(slope).max() * limits.velocity[index] == pytest.approx(1.0, rel=1e-6)
    assert limits.leg.position == machine.legs.working_stroke


def test_a_machine_may_be_in_millimetres(tmp_path: Path) -> None:
    """All lengths and speeds of a data sheet in mm and mm/s: the same machine and limits."""
    lab = table_of()

    def in_mm(table: dict[str, Any]) -> dict[str, Any]:
        if table.get("unit") in ("m", "m/s"):
            value = (1000.0 * np.array(table["value"])).tolist()
            return table | {"value": value, "unit": table["unit"].replace("m", "mm", 1)}
        return {n: in_mm(one) if isinstance(one, dict) else one for n, one in table.items()}

    metres = load_machine(written(tmp_path, lab))
    millimetres = load_machine(written(tmp_path, in_mm(lab)))
    for one, other in zip(metres.geometry, millimetres.geometry, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)
    ends = [load_motion_limits(None, machine) for machine in (metres, millimetres)]
    assert ends[0].leg.position.si == pytest.approx(ends[1].leg.position.si)
    np.testing.assert_allclose(ends[0].velocity, ends[1].velocity, rtol=1e-9)


def test_an_unknown_unit_is_refused_with_those_of_its_kind(tmp_path: Path) -> None:
    table = table_of()
    table["legs"]["half_stroke"] = stated(1.0, "furlong")
    with pytest.raises(cmf_mj.InputError, match=r"half_stroke: 'furlong' is .* one of in, m, mm$"):
        load_machine(written(tmp_path, table))


def test_a_law_of_a_file_of_several_lies_beside_the_machine(tmp_path: Path) -> None:
    machine = load_machine(written(tmp_path, table_of() | {"law": "two.toml:second"}))
    assert machine.law == str(tmp_path.resolve() / "two.toml:second")
    assert load_machine(written(tmp_path, table_of() | {"law": "original"})).law == "original"


def test_a_stated_limit_stays(tmp_path: Path) -> None:
    table = table_of()
    span = {"low": -0.1, "high": 0.1, "unit": "m", "status": "stated", "source": "test"}
    table["limits"]["heave"] = {
        "mechanical": span,
        "operational": span,
        "velocity": stated(0.2, "m/s"),
        "acceleration": stated(2.0, "m/s^2"),
    }
    limits = load_motion_limits(None, written(tmp_path, table))
    assert limits.heave.operational.si == (-0.1, 0.1) and limits.surge.velocity.status == "derived"


# A model of one's own


def test_an_edited_model_is_a_machine_with_its_own_geometry(tmp_path: Path) -> None:
    """Upper gimbal 1 moved 0.1 m: leg 1 is that much longer in kinematics, model and record."""
    text = models.model_path("cmf_hexapod.xml").read_text("utf-8")
    site = '<site name="upper_1" class="marker" pos="2.31902 -0.228092 -0.00127"/>'
    assert site in text
    moved = text.replace(site, site.replace("2.31902", "2.41902"))
    new = np.array([2.41902, -0.228092, -0.00127]) - [1.680718, -2.386584, -3.380232]
    length = float(np.linalg.norm(new))
    moved = moved.replace(
        'zaxis="0.638302 2.158492 3.378962"', f'zaxis="{new[0]} {new[1]} {new[2]}"'
    )
    for old in ("4.060037112480", "3.760037112480"):
        place = f'_1" class="marker" pos="0 0 {old}"'
        assert place in moved
        moved = moved.replace(
            place, place.replace(old, repr(length - (4.060037112480 - float(old))))
        )
    (tmp_path / "edited.xml").write_text(moved)
    table = table_of("cmf") | {"mjcf": "edited.xml"}
    cab = str(models.directory() / "cabs" / "gfd.xml")
    table["cabs"] = {"deck": {"mjcf": cab}}
    machine = load_machine(written(tmp_path, table))
    assert machine.geometry.neutral[0] == pytest.approx(length, abs=1e-12)
    plant = cmf_mj.Hexapod(machine=machine)
    pose = np.array([0.2, -0.1, 0.1, 0.05, -0.04, 0.06])
    plant.place(pose)
    np.testing.assert_allclose(plant.extensions(), pose_to_legs(pose, machine), atol=1e-9)
    assert np.abs(pose_to_legs(pose) - pose_to_legs(pose, machine)).max() > 1e-3
    command = cmf_mj.signals.step("heave", 0.01)
    record = cmf_mj.simulate(plant, "velocity", command, record_every=16)
    assert recorded_machine(record.metadata) == machine
    found = recorded_cab(record.metadata)
    assert found is not None and found.machine == machine
    rows = legs_to_pose(record["leg_extension"], recorded_machine(record.metadata))
    np.testing.assert_allclose(rows, record["platform_pose"], atol=1e-5)


# What is refused


def change(**tables: Any) -> dict[str, Any]:
    return tables


CIRCLE = (
    "either upper and lower, or upper_radius, upper_spacing, lower_radius, lower_spacing, height"
)
BROKEN: list[tuple[dict[str, Any], str]] = [
    (change(name="cmf"), "name: 'cmf' is the name of a shipped machine"),
    (change(cabs={}), "cabs: {} is refused"),
    (change(gimbals={"height": None}), f"gimbals: height: is missing; allowed: {CIRCLE}"),
    (change(gimbals={"upper": stated([[0, 0, 0]] * 6)}),
     "gimbals: upper: is given with upper_radius"),
    (change(gimbals={"lower_radius": stated(0.6),
     "lower_spacing": stated(100, "deg")}), "gimbals: the legs do not hold the "
     "platform at neutral, condition number"),
    (change(legs={"half_stroke": stated(0.4)}),
     "legs.half_stroke: 0.4 m is refused: a retracted leg, 0.6366 m"),
    (change(legs={"working_stroke": stated(0.21)}),
     "legs: working_stroke: 0.21 m must be at most half_stroke, 0.2 m"),
    (change(platform={"centre_of_mass": stated([0, 0, -3])}),
     "platform.centre_of_mass: is -3 m above the upper gimbals, below the floor; "
     "allowed: at least -0.99 m"),
    (change(cabs={"gfd": table_of()["cabs"]["payload"]}), "cabs.gfd: is the name of a cab of cmf"),
    (change(control_rate=stated(100, "Hz")), "control_rate: 100 Hz is refused; allowed: a whole"),
    (change(mjcf="none.xml"), "mjcf: .*none.xml cannot be read: No such file"),
    (change(hydraulics={"base": "hard"}), "mine: hydraulics: base: 'hard' is not one of report"),
    (change(hydraulics={"bore": stated(40, "mm")}), "mine: hydraulics: bore: is not a known field"),
    (change(hydraulics={"half_stroke": stated(0.2)}),
     "mine: hydraulics: half_stroke: is taken from"),
    (change(hydraulics={"rod_diameter": stated(50, "mm")}),
     "mine: hydraulics: rod_diameter: 50 mm must be less than bore_diameter, 40 mm"),
]  # fmt: skip


def without_none(table: dict[str, Any]) -> dict[str, Any]:
    return {
        name: without_none(entry) if isinstance(entry, dict) else entry
        for name, entry in table.items()
        if entry is not None
    }


@pytest.mark.parametrize(("changes", "message"), BROKEN)
def test_a_broken_machine_is_refused_with_one_clear_error(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    table = without_none(
        table_of() | changes if {} in changes.values() else merged(table_of(), changes)
    )
    text = re.escape(message).replace(r"\.\*", ".*")
    with pytest.raises(cmf_mj.InputError, match=text) as refused:
        cmf_mj.Hexapod(machine=written(tmp_path, table))
    assert len(str(refused.value).splitlines()) == 1


def test_no_such_machine() -> None:
    with pytest.raises(cmf_mj.InputError, match="machine: 'simon' is not one of cmf, lab, simona"):
        load_machine("simon")
    with pytest.raises(cmf_mj.InputError, match="nowhere.toml: cannot be read"):
        load_machine("nowhere.toml")
    with pytest.raises(cmf_mj.InputError, match="cab: 'gfd' is not one of srs nor a .toml file"):
        load_cab("gfd", "simona")
    with pytest.raises(cmf_mj.InputError, match="cab: 'gfd' is one of machine 'cmf', not of 'lab'"):
        load_cab(load_cab("gfd"), "lab")


def test_a_machine_is_hashed_by_name_and_compared_by_number() -> None:
    lab = load_machine("lab")
    other = Machine.model_validate(lab.model_dump() | {"title": "another"})
    assert hash(other) == hash(lab) and other != lab
