"""Guesses of what a recording's columns are, where a word has two meanings or none."""

from pathlib import Path

import numpy as np
import pytest

from cmf_mj.record.columns import ColumnMap, load_columns
from cmf_mj.record.guess import guess_columns

AXES = ("x", "y", "z", "phi", "theta", "psi")


def guessed(names: list[str], folder: Path, step: float = 0.002) -> tuple[ColumnMap, str]:
    file, found = folder / "log.csv", folder / "map.toml"
    rows = np.column_stack([step * np.arange(9), np.ones((9, len(names)))])
    np.savetxt(file, rows, delimiter=",", header=",".join(["t", *names]), comments="")
    found.write_text(guess_columns(file))
    return load_columns(found), found.read_text()


def test_psi_is_yaw_where_no_pressure_is_meant(tmp_path: Path) -> None:
    made, _ = guessed([f"pose_{axis}" for axis in AXES], tmp_path)
    assert made.columns("platform_pose")[5][:2] == ("pose_psi", "rad")
    made, _ = guessed([f"p{k}_psi" for k in range(1, 7)], tmp_path)
    assert made.columns("cap_pressure")[0][:2] == ("p1_psi", "psi")
    made, _ = guessed(
        [*(f"{axis}_mm" for axis in AXES[:3]), "supply_psi", *(f"{a}_deg" for a in AXES[3:])],
        tmp_path,
    )
    assert made.columns("platform_pose")[5][:2] == ("psi_deg", "deg")


def test_in_is_an_input_where_no_length_is_meant(tmp_path: Path) -> None:
    made, text = guessed([f"valve_in_{k}" for k in range(1, 7)], tmp_path)
    assert made.columns("valve_command")[0][:2] == ("valve_in_1", "%")
    assert "no unit in 'valve_in_1'" in text
    made, _ = guessed([f"x_in_{k}" for k in range(1, 7)], tmp_path)
    assert made.columns("leg_position")[0][:2] == ("x_in_1", "in")
    made, text = guessed([f"flow{k}_in" for k in range(1, 7)] + AXES_OF_NOTHING, tmp_path)
    assert "# not recognised: flow1_in" in text


AXES_OF_NOTHING = [f"v{k}" for k in range(1, 7)]


@pytest.mark.parametrize(("place", "bad"), [(0, "x [bar]"), (0, "x [deg]"), (4, "pitch [m]")])
def test_an_axis_has_a_unit_of_its_own(place: int, bad: str, tmp_path: Path) -> None:
    names = ["x [mm]", "y [mm]", "z [mm]", "roll [deg]", "pitch [deg]", "yaw [deg]"]
    made, _ = guessed([*names, *AXES_OF_NOTHING], tmp_path)
    assert "platform_pose" in made.channels
    names[place] = bad
    made, _ = guessed([*names, *AXES_OF_NOTHING], tmp_path)
    assert [*made.channels] == ["leg_velocity"]


def test_the_name_without_a_unit_is_the_one_in_doubt(tmp_path: Path) -> None:
    names = ["x [mm]", "y [mm]", "z", "roll [deg]", "pitch [deg]", "yaw [deg]"]
    assert "platform_pose: no unit in 'z': the one below" in guessed(names, tmp_path)[1]


def test_pressures_of_no_side_are_in_doubt(tmp_path: Path) -> None:
    sides = [f"p{k} [bar]" for k in range(1, 7)]
    made, text = guessed(sides, tmp_path)
    assert [*made.channels] == ["cap_pressure"]
    assert "cap_pressure: 'p1 [bar]' names no side of the piston: cap is a guess" in text
    assert "no side" not in guessed([f"p_cap{k} [bar]" for k in range(1, 7)], tmp_path)[1]


@pytest.mark.parametrize(
    ("step", "unit"), [(0.1, "s"), (0.05, "s"), (0.488, "ms"), (1.0, "ms"), (100.0, "ms")]
)
def test_time_without_a_unit_has_an_ordinary_rate(step: float, unit: str, tmp_path: Path) -> None:
    """From 10 Hz on in s or ms: a step of 0.488 is 2048 Hz in ms, not 2 Hz."""
    made, text = guessed(AXES_OF_NOTHING, tmp_path, step)
    assert made.time.unit == unit
    assert f"time: no unit in 't': {unit!r} is a guess" in text
