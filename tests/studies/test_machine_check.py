"""What `cmf machine check` finds: machines with one plausible mistake each."""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomlkit
from scipy.optimize import minimize
from shared import cmf

from cmf_mj import InputError, load_cab, load_machine
from cmf_mj.analysis.modes import envelope_poses
from cmf_mj.machine.kinematics import rotation
from cmf_mj.machine.machine import Machine
from cmf_mj.machine.models import directory
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.studies.machine_check import _clearance, check_machine, report_parts

POSES = 20


def changed(folder: Path, **parts: Any) -> Machine:
    """The shipped laboratory machine, its tables with other fields, from a file."""
    source = directory() / "machines" / "lab.toml"
    table = tomllib.loads(source.read_text(encoding="utf-8"))
    table["name"], table["law"] = "mine", "velocity"
    for part, fields in parts.items():
        table[part] = fields if part == "gimbals" else table.get(part, {}) | fields
    path = folder / "mine.toml"
    path.write_text(tomlkit.dumps(table), encoding="utf-8")
    return load_machine(path)


def stated(value: Any, unit: str = "m") -> dict[str, Any]:
    return {"value": value, "unit": unit, "status": "assumed", "source": "a test"}


def gimbals(upper: Any, lower: Any) -> dict[str, Any]:
    return {"upper": stated(upper.tolist()), "lower": stated(lower.tolist())}


@pytest.fixture(scope="module")
def points() -> tuple[Any, Any]:
    """Upper and lower gimbals of the laboratory machine, z up."""
    shape = load_machine("lab").geometry
    turn = np.array([1.0, -1.0, -1.0])
    return shape.upper * turn, shape.lower * turn


def test_gimbals_one_by_one_are_the_same_machine(points: Any, tmp_path: Path) -> None:
    assert check_machine(changed(tmp_path, gimbals=gimbals(*points)), poses=POSES).faults == ()


def test_legs_that_cross_are_found(points: Any, tmp_path: Path) -> None:
    """Lower gimbals 1 and 2 exchanged: a machine that closes and holds, whose legs collide."""
    upper, lower = points
    machine = changed(tmp_path, gimbals=gimbals(upper, lower[[1, 0, 2, 3, 4, 5]]))
    (fault,) = check_machine(machine, poses=POSES).faults
    assert fault.startswith("gimbals: the axes of legs 1 and 2 come within")
    assert "allowed: at least a rod's diameter, 0.028 m" in fault


def test_the_distance_of_axes_is_the_least_of_all_points_on_them() -> None:
    """Against a search over both legs of every pair, at four poses: 1e-6 m."""
    machine = load_machine("simona")
    poses = envelope_poses(Hexapod(load_cab(None, machine)), 4)
    upper, lower, _ = machine.geometry
    for pose in poses:
        tops = pose[:3] + upper @ rotation(*pose[3:]).T
        least = np.inf
        for i in range(6):
            for j in range(i):

                def apart(share: Any, i: int = i, j: int = j, tops: Any = tops) -> float:
                    one = lower[i] + share[0] * (tops[i] - lower[i])
                    other = lower[j] + share[1] * (tops[j] - lower[j])
                    return float(np.linalg.norm(one - other))

                for start in ([0.1, 0.1], [0.9, 0.9]):
                    found = minimize(apart, start, bounds=[(0.0, 1.0)] * 2)
                    least = min(least, float(found.fun))
        assert _clearance(machine, pose[None])[0] == pytest.approx(least, abs=1e-6)


def test_limits_that_the_legs_do_not_reach_are_found(tmp_path: Path) -> None:
    """0.6 m of heave on legs that reach 0.2 m; what they reach is no fault."""
    speed = {"velocity": stated(0.2, "m/s"), "acceleration": stated(1.0, "m/s^2")}
    for size, faults in ((0.2, []), (0.6, ["operational", "mechanical"])):
        ends = {"low": -size, "high": size, "unit": "m", "status": "stated", "source": "a test"}
        heave = {"heave": {"mechanical": ends, "operational": ends} | speed}
        found = check_machine(changed(tmp_path, limits=heave), poses=POSES).faults
        assert [fault.split(":")[0] for fault in found] == [f"limits.heave.{x}" for x in faults]
    assert "-0.6 to 0.6 m; allowed: within -0.2025 to 0.215 m" in found[0]
    with pytest.raises(InputError, match="poses: 0 is refused; allowed: a whole number from 1"):
        check_machine(load_machine("lab"), poses=0)


def test_each_leg_is_held_against_its_own_cylinder(tmp_path: Path) -> None:
    """Leg 4 with half the bore: the legs' forces stay, its share is four times as large or more."""
    table = tomllib.loads((directory() / "machines" / "lab.toml").read_text(encoding="utf-8"))
    slim = {
        key: table["hydraulics"][key] | {"value": 0.5 * table["hydraulics"][key]["value"]}
        for key in ("bore_diameter", "rod_diameter")
    }
    usual = check_machine(changed(tmp_path), poses=2)
    check = check_machine(changed(tmp_path, hydraulics={"actuators": {"leg_4": slim}}), poses=2)
    np.testing.assert_allclose(check.stall, 0.25 * usual.stall)
    load = check.cabs[0].load[3]
    assert check.cabs[0].share == pytest.approx(abs(load) / check.stall[int(load < 0.0)])


def test_legs_in_inches_typed_as_metres_are_found(points: Any, tmp_path: Path) -> None:
    far = gimbals(*(39.37 * part for part in points))
    machine = changed(tmp_path, gimbals=far, floor=stated(-45.0))
    said = " ".join(check_machine(machine, poses=POSES).faults)
    assert (
        "legs.half_stroke: legs of 40.81 m for a stroke of 0.4 m; allowed: up to 15 times" in said
    )


@pytest.mark.parametrize("shift", [[0.5, 0.0, 0.0], [0.0, -0.5, 0.0], [0.0, 0.0, 0.5]])
def test_an_origin_off_the_centroid_is_found(points: Any, tmp_path: Path, shift: Any) -> None:
    machine = changed(tmp_path, gimbals=gimbals(*(part + np.array(shift) for part in points)))
    said = " ".join(check_machine(machine, poses=POSES).faults)
    assert "gimbals: the upper gimbals' centroid is 0.5 m from the origin" in said


@pytest.mark.parametrize(("factor", "faults"), [(1.0, 0), (10.0, 1)])
def test_a_payload_ten_times_too_large_is_found(factor: float, faults: int, tmp_path: Path) -> None:
    """The legs carry what moves: the sum of their forces' vertical parts is the weight of cab and
    platform and of the legs' upper ends, and the largest force over a cylinder's is the share. To
    accelerate by the limit in heave as well takes 1 + a/g of it."""
    payload = tomllib.loads((directory() / "machines" / "lab.toml").read_text())["cabs"]["payload"]
    mass = payload["mass"] | {"value": 300.0 * factor}
    machine = changed(tmp_path, cabs={"payload": payload | {"mass": mass}})
    check = check_machine(machine, poses=2)
    (cab,) = check.cabs
    upper, lower, neutral = machine.geometry
    vertical = np.abs((upper - lower)[:, 2]) / neutral
    carried = float(np.abs(cab.load) @ vertical) / 9.80665
    assert cab.mass < carried < 1.4 * cab.mass
    assert cab.share == pytest.approx(np.abs(cab.load).max() / check.stall[0])
    rise = 1.0 + check.limits.axes[2].acceleration.si / 9.80665
    assert (cab.share * rise > 1.0) == bool(faults)
    said = [part for part in report_parts(check) if isinstance(part, str)]
    assert sum("its static load is" in line for line in said) == faults
    assert (said[-1] == "verdict: mine fits together") == (not faults)


def test_the_command_tells_a_fault_with_status_1(points: Any, tmp_path: Path) -> None:
    upper, lower = points
    changed(tmp_path, gimbals=gimbals(upper, lower[[1, 0, 2, 3, 4, 5]]))
    said = cmf("machine", "check", tmp_path / "mine.toml", code=1)
    assert "axes of legs 1 and 2" in " ".join(said.split())


@pytest.mark.parametrize("centre", [[0.0, 0.0, 36.0], [36.0, 0.0, 0.0], [0.0, 4.1, 0.0]])
def test_a_cab_farther_off_than_a_leg_is_long_is_refused(centre: Any) -> None:
    """36 in typed as 36 m; the legs of the CMF are 4.06 m long."""
    with pytest.raises(InputError, match=r"centre_of_mass: is .* allowed: at most 4\.06 m"):
        load_cab("gfd").changed("mine", centre_of_mass=centre)


def test_an_inertia_that_is_not_symmetric_is_refused() -> None:
    tensor = np.diag([3e4, 4e4, 5e4])
    tensor[0, 1] = 1e3
    with pytest.raises(InputError, match="mine: inertia: .* is refused: not symmetric"):
        load_cab("gfd").changed("mine", inertia=tensor)
    with pytest.raises(InputError, match="mine: inertia: .* is refused: not symmetric"):
        load_cab("gfd").changed("mine", inertia=tensor.T)
    tensor[1, 0] = 1e3
    np.testing.assert_allclose(load_cab("gfd").changed("mine", inertia=tensor).tensor, tensor)
