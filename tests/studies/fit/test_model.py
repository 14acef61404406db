"""What a machine carries is weighed at rest, in closed form."""

from pathlib import Path

import numpy as np
import pytest
import tomlkit
from scipy import stats

import cmf_mj
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.studies.fit.campaign import FILE, load_campaign
from cmf_mj.studies.fit.model import Model, find_rests

RATE = 128
POSES = np.array([[0, 0, 0, 0, 0, 0], [0, 0, 0, 0.2, 0, 0], [0, 0, 0, 0, 0.2, 0]])
WHERE = {"x": 0.03, "y": -0.02, "z": 0.05}  #: What the centre of mass is off the data sheet [m].
UNKNOWNS = {"mass": {"path": "cab.mass", "deviation": 40.0, "source": "test"}} | {
    f"centre_{axis}": {"path": f"cab.centre_of_mass.{axis}", "deviation": 0.1, "source": "test"}
    | {"effect": "offset", "unit": "m"}
    for axis in WHERE
}


def held(folder: Path, seconds: float, friction: float = 0.0) -> Model:
    """A machine 15 % lighter, at rest in poses for so many seconds each."""
    sheet = cmf_mj.load_cab(None, "lab")
    place = np.array(sheet.centre_of_mass.si) + list(WHERE.values())
    cab = sheet.changed("hidden", mass=0.85 * sheet.mass.si, centre_of_mass=place)
    plant = cmf_mj.Hexapod(cab)
    cylinder, forces = plant.hydraulics.cylinder, []
    for pose in POSES:
        plant.place(pose)
        forces.append(plant.static_load())
    each = round(seconds * RATE)
    force = np.repeat(forces, each, axis=0) + friction
    legs = np.repeat(pose_to_legs(POSES, plant.machine), each, axis=0)
    rod = np.full_like(force, 1e6)
    cap = (force + cylinder.rod_area * rod) / cylinder.cap_area
    channels = {"leg_reference": legs, "leg_position": legs, "cap_pressure": cap}
    channels |= {"rod_pressure": rod}
    units = {name: "Pa" if "pressure" in name else "m" for name in channels}
    time = np.arange(len(legs)) / RATE
    cmf_mj.Record(time, channels, units, {"sample_rate": RATE}).save(folder / "a.parquet")
    table = {"machine": "lab", "law": "original", "unknowns": UNKNOWNS}
    table |= {"recordings": {"a": {"file": "a.parquet", "kind": "hold"}}}
    (folder / FILE).write_text(tomlkit.dumps(table), encoding="utf-8")
    return Model(load_campaign(folder))


@pytest.mark.parametrize(("friction", "share", "place"), [(0.0, 1e-3, 2e-3), (5.0, 2e-2, 1e-2)])
def test_rests_weigh_what_is_carried(
    tmp_path: Path, friction: float, share: float, place: float
) -> None:
    """Of three poses, friction of 5 N in each leg costs 2 % and a tenth of what was not known."""
    model = held(tmp_path, 3.0, friction)
    values = model.values(model.weigh())
    assert values["mass"] == pytest.approx(0.85, rel=share)
    for axis, off in WHERE.items():
        assert values[f"centre_{axis}"] == pytest.approx(off, abs=place), axis


def test_what_moves_is_not_weighed(tmp_path: Path) -> None:
    model = held(tmp_path, 0.4)
    assert find_rests(model.pieces[0], model.plant) == []
    np.testing.assert_array_equal(stats.norm.cdf(model.weigh()), 0.5)
