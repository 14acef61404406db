"""Guesses of what a recording's columns are, where a word has two meanings or none."""

from pathlib import Path

import pytest

from cmf_mj import load_machine
from cmf_mj.record.columns import ColumnMap, load_columns, read_mapped
from cmf_mj.record.guess import guess_columns

AXES = ("x", "y", "z", "phi", "theta", "psi")


def guessed(
    names: list[str], folder: Path, step: object = 0.002, time: str = "t"
) -> tuple[ColumnMap, str]:
    """The map of a header, above rows of which the time goes up by a step."""
    file, found = folder / "log.csv", folder / "map.toml"
    first = [f"12:00:{k:02}.5" if step == "clock" else str(float(k * step)) for k in range(9)]  # type: ignore[operator]
    rows = [",".join([one, *("1" for _ in names)]) for one in first]
    file.write_text("\n".join([",".join([time, *names]), *rows]))
    found.write_text(guess_columns(file))
    return load_columns(found), found.read_text()


def test_psi_is_yaw_where_no_pressure_is_meant(tmp_path: Path) -> None:
    made, _ = guessed([f"pose_{axis}" for axis in AXES], tmp_path)
    assert made.columns("platform_pose")[5][:2] == ("pose_psi", "rad")
    made, _ = guessed([f"p{k}_psi" for k in range(1, 7)], tmp_path)
    assert made.columns("cap_pressure")[0][:2] == ("p1_psi", "psi")
    lengths, angles = [f"{axis}_mm" for axis in AXES[:3]], [f"{axis}_deg" for axis in AXES[3:]]
    made, _ = guessed([*lengths, "supply_psi", *angles], tmp_path)
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


def test_guess_reads_names_units_and_labels(tmp_path: Path) -> None:
    names = [f"Leg {leg} Length (in)" for leg in "ABCDEF"]
    names += [f"p{k} [bar]" for k in range(1, 7)] + [f"dmd_{axis}" for axis in "x y z".split()]
    names += ["dmd_roll [rad]", "dmd_pitch [rad]", "dmd_yaw [rad]", "oil [C]"]
    made, text = guessed(names, tmp_path, 1, "Time [ms]")
    assert (made.time.column, made.time.unit) == ("Time [ms]", "ms")
    assert made.channels["leg_position"].unit == "in"
    assert made.columns("cap_pressure")[2] == ("p3 [bar]", "bar", 1, 1.0, 0.0)
    assert made.channels["demand_pose"].unit == ("m", "m", "m", "rad", "rad", "rad")
    assert "# not recognised: oil [C]" in text
    assert "# other channels: leg_velocity, " in text
    assert "no unit in 'dmd_x'" in text


@pytest.mark.parametrize(
    ("name", "channel", "unit"),
    [
        ("cyl{}_vel_mm_s", "leg_velocity", "mm/s"),
        ("cyl{}_set_mm", "leg_reference", "mm"),
        ("Act{}.Pann [bar]", "rod_pressure", "bar"),
        ("leg{}_p_rod (psi)", "rod_pressure", "psi"),
        ("xref{} [m]", "leg_reference", "m"),
        ("valve_cmd_{}_pct", "valve_command", "%"),
        ("ActPos{} [mm]", "leg_position", "mm"),
        ("Z{}_Ventil_mA", "valve_command", "%"),
        ("Z{}_Soll_mm", "leg_reference", "mm"),
    ],
)
def test_guess_of_a_channel(name: str, channel: str, unit: str, tmp_path: Path) -> None:
    made, _ = guessed([name.format(k) for k in range(1, 7)], tmp_path)
    assert {one: found.unit for one, found in made.channels.items()} == {channel: unit}
    assert (made.time.column, made.time.unit) == ("t", "s")


@pytest.mark.parametrize(
    ("name", "step", "unit", "rate"),
    [("t", 2, "ms", 500.0), ("t", 500, "us", 2000.0), ("timestamp", "clock", "s", 1.0)],
)
def test_guess_of_time(name: str, step: object, unit: str, rate: float, tmp_path: Path) -> None:
    """By an ordinary rate, and of times of day from the first."""
    made, text = guessed([f"x{k} [mm]" for k in range(1, 7)], tmp_path, step, name)
    assert (made.time.column, made.time.unit) == (name, unit)
    assert read_mapped(tmp_path / "log.csv", made, load_machine("lab")).rate == pytest.approx(rate)
    assert ("no unit in 't'" in text) == (name == "t")


def test_pose_of_joined_words_and_a_rate_that_is_guessed(tmp_path: Path) -> None:
    axes = ["Xcmd [mm]", "Ycmd [mm]", "Zcmd [mm]", "PhiCmd [deg]", "ThetaCmd [deg]", "PsiCmd [deg]"]
    made, text = guessed(axes, tmp_path, 1, "n")
    assert [name for name, *_ in made.columns("demand_pose")] == axes
    assert made.time.rate is not None
    assert "time: no column was recognised: the rate [Hz] below is a guess" in text


def test_numbers_of_legs_are_no_axes(tmp_path: Path) -> None:
    names = [f"Z{k}_foo_mm" for k in range(1, 7)] + ["x_mm", "y_mm", "roll", "pitch", "yaw"]
    made, _ = guessed([*names[1:], *AXES_OF_NOTHING], tmp_path, 1, names[0])
    assert [*made.channels] == ["leg_velocity"]
