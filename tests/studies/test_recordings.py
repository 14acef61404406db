"""What `check_recording` says of recordings with one slip each, and of good ones."""

from collections.abc import Callable
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt
from shared import cmf

from cmf_mj import Hexapod, Record, load_machine, simulate
from cmf_mj.core.units import FOOT, PSI
from cmf_mj.machine.machine import Machine
from cmf_mj.plant.parameters import HydraulicParameters, hydraulics_of
from cmf_mj.studies import recording_pairs as pairs
from cmf_mj.studies.recordings import check_recording, verdict

Array = NDArray[np.float64]

LOADS = {"lab": 750.0, "simona": 8100.0, "cmf": 28000.0}  #: Static load of a leg [N].
OTHER = {"lab": "original", "simona": "force", "cmf": "original"}  #: Another law than its own.
RECORDED = ("leg_position", "leg_velocity", "cap_pressure", "rod_pressure", "valve_command")
SECONDS = 24


def rough(machine: Machine) -> HydraulicParameters:
    """The machine's hydraulics with friction, and valves of legs 2 and 5 that are 10 % off."""

    def stated(value: float, unit: str) -> dict[str, Any]:
        return {"value": value, "unit": unit, "status": "assumed", "source": "a test"}

    table = hydraulics_of(machine).model_dump(exclude_none=True)
    speed, load = table["leg_speed"], LOADS[machine.name]
    table["coulomb_friction"] = stated(0.04 * load, "N")
    table["breakaway_friction"] = stated(0.06 * load, "N")
    table["actuators"] = {
        leg: {"leg_speed": speed | {"value": speed["value"] * size}}
        for leg, size in (("leg_2", 0.9), ("leg_5", 1.1))
    }
    return HydraulicParameters.model_validate(table)


def motion(machine: Machine) -> Array:
    """Smooth noise in all axes, at rest at both ends."""
    count = SECONDS * machine.rate
    sections = butter(2, 1.0, fs=machine.rate, output="sos")
    noise = sosfiltfilt(sections, np.random.default_rng(3).normal(size=(count, 6)), axis=0)
    at = np.arange(count) / machine.rate
    fade = np.clip(np.minimum(at, at[::-1]) / 2.0, 0.0, 1.0)[:, None]
    size = np.array([15.0, 15.0, 10.0, 20.0, 20.0, 20.0]) * 3e-3
    return noise / noise.std(axis=0) * fade * size


@cache
def recorded(name: str, law: str) -> Record:
    machine = load_machine(name)
    plant = Hexapod(machine=machine, hydraulics=rough(machine))
    return simulate(plant, law, motion(machine), record_every=4, electronics="noisy")


def part(record: Record, channels: tuple[str, ...], end: float = 99.0, **changes: Any) -> Record:
    """Some channels of a record up to a time [s], with changes."""
    rows = record.time < end
    kept = {one: np.array(record[one][rows]) for one in channels}
    kept |= {one: change(kept[one]) for one, change in changes.items()}
    return Record(
        record.time[rows], kept, {one: record.units[one] for one in kept}, record.metadata
    )


def made(name: str, demand: str = "demand_pose", law: str = "", **changes: Any) -> Record:
    """The recording, what a logger has of it, with changes of channels."""
    record = recorded(name, law or load_machine(name).law)
    return part(record, (*RECORDED, demand), **changes)


def said(name: str, *args: str, **changes: Any) -> str:
    return verdict(check_recording(made(name, *args, **changes), load_machine(name)))


def exchanged(i: int, j: int) -> Callable[[Array], Array]:
    order = [*range(6)]
    order[i], order[j] = j, i
    return lambda values: values[:, order]


swapped = exchanged(1, 4)


def reversed_axis(axis: int) -> Callable[[Array], Array]:
    return lambda values: values * np.where(np.arange(6) == axis, -1.0, 1.0)


def clipped(values: Array) -> Array:
    most = np.where(np.arange(6) == 2, np.percentile(values[:, 2], 97), np.inf)
    return np.minimum(values, most)


def frozen(values: Array) -> Array:
    at = np.arange(len(values))[:, None]
    return np.where((np.arange(6) == 1) & (at > 4000), values[4000], values)


def half_missing(values: Array) -> Array:
    return np.where(np.arange(6) < 3, values, np.nan)


def with_gap(values: Array) -> Array:
    return np.where((np.arange(len(values)) // 30 == 40)[:, None], np.nan, values)


def later(seconds: float) -> Callable[[Array], Array]:
    return lambda values: np.roll(values, round(seconds * 512), axis=0)


PRESSURES = ("cap_pressure", "rod_pressure")
SLIPS: dict[str, tuple[dict[str, Any], str]] = {
    "legs": ({"leg_position": swapped}, "legs 2 and 5 are exchanged"),
    "all of a leg": (dict.fromkeys(RECORDED, swapped), "legs 2 and 5 are exchanged"),
    "pressures": (
        dict.fromkeys(PRESSURES, swapped),
        "both pressures of legs 2 and 5 are exchanged",
    ),
    "feet": ({"leg_position": lambda v: v / FOOT}, "the file has ft where the map says m"),
    "mm": ({"leg_position": lambda v: 25.4 * v}, "the file has mm where the map says in"),
    "in": ({"leg_position": lambda v: v / 25.4}, "the file has in where the map says mm"),
    "still": ({"leg_position": np.zeros_like}, "leg_position: does not follow demand_pose"),
    "feet of the pose": (
        {"demand_pose": lambda v: v / np.where(np.arange(6) < 3, FOOT, 1.0)},
        "its lengths are in ft where the map says m",
    ),
    "degrees": (
        {"demand_pose": lambda v: np.where(np.arange(6) < 3, v, np.degrees(v))},
        "its angles are in deg where the map says rad",
    ),
    "psi": (
        dict.fromkeys(PRESSURES, lambda v: v / PSI * 1e5),
        "the file has psi where the map says bar",
    ),
    "heave": ({"demand_pose": reversed_axis(2)}, "heave has the other sign"),
    "pitch": ({"demand_pose": reversed_axis(4)}, "pitch has the other sign"),
    "leg": ({"leg_position": reversed_axis(3)}, "leg 4 has the other sign"),
    "velocity": (
        {"leg_velocity": np.negative},
        "leg_velocity: against the slope of positions: all",
    ),
    "valves": ({"valve_command": np.negative}, "valve_command: against velocities: all legs have"),
    "clock early": ({"demand_pose": later(0.2)}, "the clocks of the two are apart"),
    "clock late": ({"demand_pose": later(-0.6)}, "the clocks of the two are apart"),
    "clipped": ({"leg_position": clipped}, "leg 3 stays at"),
    "valve clipped": ({"valve_command": clipped}, "valve_command: leg 3 stays at"),
    "frozen": ({"leg_position": frozen}, "leg 2 stands still from"),
    "gap": ({"leg_position": with_gap}, "30 samples without a number in 1 gaps, the longest from"),
}


@pytest.mark.parametrize("name", LOADS)
@pytest.mark.parametrize("slip", SLIPS)
def test_a_slip_is_named(name: str, slip: str) -> None:
    changes, words = SLIPS[slip]
    assert words in said(name, **changes)


@pytest.mark.parametrize("name", LOADS)
@pytest.mark.parametrize("demand", ["demand_pose", "leg_reference"])
def test_a_good_recording_has_no_fault(name: str, demand: str) -> None:
    """With noisy electronics, friction, and valves that are not alike."""
    assert said(name, demand).startswith("the recording fits the machine")
    assert said(name, demand, OTHER[name]).startswith("the recording fits the machine")


@pytest.mark.parametrize("name", LOADS)
def test_half_the_pressures_are_a_loss_that_is_stated(name: str) -> None:
    words = said(name, **dict.fromkeys(PRESSURES, half_missing))
    assert words.startswith("the recording fits the machine; lost: cap_pressure: legs 4 5 6 not")


def test_legs_alone_do_not_show_a_unit_that_all_lengths_share() -> None:
    machine = load_machine("lab")
    for demand, count in (("leg_reference", 1), ("demand_pose", 0)):
        found = check_recording(made("lab", demand), machine)
        assert sum("no pose was recorded" in one.text for one in found) == count


@cache
def held(name: str) -> Record:
    """Poses at rest, joined by smooth moves too slow for inertia, after 1 s at neutral."""
    machine = load_machine(name)
    poses = np.random.default_rng(5).uniform(-1.0, 1.0, (6, 6)) * LOADS[name] ** 0.3 * 4e-3
    poses[0] = 0.0
    at = np.arange(14 * machine.rate) / machine.rate / 2.0
    part = np.clip(2.0 * (at % 1.0) - 1.0, 0.0, 1.0)[:, None]
    first = np.minimum(at.astype(int), 5)
    after = poses[np.minimum(first + 1, 5)]
    demand = poses[first] + (after - poses[first]) * (3.0 - 2.0 * part) * part**2
    plant = Hexapod(machine=machine, hydraulics=rough(machine))
    return simulate(plant, machine.law, demand, record_every=4, electronics="noisy")


@pytest.mark.parametrize("name", LOADS)
def test_pressures_exchanged_show_in_poses_at_rest(name: str) -> None:
    """With friction that no data sheet states; what is not named is said not to show."""
    machine = load_machine(name)
    good = check_recording(part(held(name), RECORDED), machine)
    assert verdict(good) == "the recording fits the machine"
    alike = " ".join(one.text for one in good if one.name == "force" and one.status == "unseen")
    named = 0
    for i, j in combinations(range(6), 2):
        changes = dict.fromkeys(PRESSURES, exchanged(i, j))
        said = verdict(check_recording(part(held(name), RECORDED, **changes), machine))
        words = f"both pressures of legs {i + 1} and {j + 1} are exchanged"
        named += said.endswith(words)
        assert said.endswith(words) or words in alike
    assert named >= 14


@pytest.mark.parametrize("name", LOADS)
def test_in_one_pose_legs_carry_alike(name: str) -> None:
    """At neutral mirrored legs do: nothing is named, also where sensors are off by 5 %."""
    machine = load_machine(name)
    area = Hexapod(machine=machine).hydraulics.cylinder.cap_area
    random = np.random.default_rng(7)
    for changes in (dict.fromkeys(PRESSURES, exchanged(1, 4)), {}, {}, {}):
        off = random.normal(size=6) * 0.05 * LOADS[name] / area
        both = changes or {"cap_pressure": lambda values, off=off: values + off}
        found = check_recording(part(held(name), RECORDED, 1.0, **both), machine)
        assert verdict(found).startswith("the recording fits the machine")
        assert any("does not show: these carry alike" in one.text for one in found)


def test_what_bears_on_legs_is_found_of_any_load() -> None:
    """Exact sums of parts leave nothing; two columns exchanged leave what mending takes away."""
    random = np.random.default_rng(0)
    parts = random.normal(size=(80, 6, 4))
    force = parts @ [3.0, -1.0, 0.5, 2.0]
    for legs in ((0, 1), (2, 5)):
        slips = [("legs 1 and 2", exchanged(0, 1)), ("legs 3 and 6", exchanged(2, 5))]
        wrong = exchanged(*legs)(force)
        fits, _ = pairs.explain_forces(
            parts, wrong, [(text, exchange(wrong)) for text, exchange in slips]
        )
        assert fits.slip == f"legs {legs[0] + 1} and {legs[1] + 1}"
    fits, alike = pairs.explain_forces(
        parts, force, [(text, exchange(force)) for text, exchange in slips]
    )
    assert (fits.slip, alike) == ("", [])
    assert fits.unexplained == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("name", LOADS)
def test_lengths_beyond_a_leg_name_their_unit(name: str) -> None:
    """Gimbal to gimbal the range names one; from neutral what the valves allow does."""
    machine = load_machine(name)
    neutral = machine.geometry.neutral
    for unit, size in (("ft", FOOT), ("in", FOOT / 12.0), ("mm", 1e-3)):
        one = part(held(name), ("leg_position",), leg_position=lambda v, s=size: (v + neutral) / s)
        words = f"the file has {unit} where the map says m, from gimbal to gimbal: state `offset`"
        assert words in verdict(check_recording(one, machine))
        channels = ("leg_position", "valve_command")
        one = part(held(name), channels, leg_position=lambda v, s=size: v / s)
        words = f"the file has {unit} where the map says m, or the scale of valve_command"
        assert words in verdict(check_recording(one, machine))
    one = part(held(name), ("leg_position",), leg_position=lambda v: v + neutral)
    assert "from gimbal to gimbal? State `offset`" in verdict(check_recording(one, machine))
    good = check_recording(part(held(name), ("leg_position", "valve_command")), machine)
    assert verdict(good).startswith("the recording fits the machine")
    assert any("times as long they fit the stroke too" in one.text for one in good)


@pytest.mark.parametrize("name", LOADS)
@pytest.mark.parametrize("early", [-0.06, 0.0, 0.02, 0.04, 0.06])
def test_a_reference_before_its_pose_is_a_fault(name: str, early: float) -> None:
    """The host's clock is ahead of the controller's; behind, it is as if the host were slow."""
    channels = ("leg_position", "leg_reference", "demand_pose")
    record = part(recorded(name, load_machine(name).law), channels, demand_pose=later(early))
    found = check_recording(record, load_machine(name))
    words = "nothing moves before it is asked to" if early > 0.0 else "the recording fits"
    assert words in verdict(found)
    clock = next(one for one in found if one.name == "clock" and one.channel == "leg_reference")
    assert clock.value == pytest.approx(-1e3 * round(early * 512) / 512, abs=2.0)


def test_a_delay_is_as_sure_as_the_noise_allows() -> None:
    """Its error is below two deviations in 19 of 20 cases, more or less."""
    rate, held = 50.0, 0
    sections = butter(2, 0.8, fs=rate, output="sos")
    for seed in range(40):
        random = np.random.default_rng(seed)
        asked = sosfiltfilt(sections, random.normal(size=(1000, 6)), axis=0)
        asked *= np.hanning(1000)[:, None]  # at rest at both ends
        noise = random.normal(size=asked.shape) * asked.std() * random.uniform(0.3, 2.0)
        found = pairs.compare(asked, np.roll(asked, 3, axis=0) + noise, rate, 1e-3)
        assert found is not None
        held += abs(found.delay - 0.06) < found.delay_error + 0.5 / rate / 32.0
    assert held >= 34


def test_command_maps_and_checks(tmp_path: Path) -> None:
    """Columns of her own, in ms, mm and bar: a guess of the map, then the check."""
    record, columns = made("lab", "leg_reference"), {}
    for channel, stem, size in (
        ("leg_position", "x{}_mm", 1e-3),
        ("leg_reference", "xref{}_mm", 1e-3),
        ("cap_pressure", "pa{} [bar]", 1e5),
        ("rod_pressure", "pb{} [bar]", 1e5),
    ):
        columns |= {stem.format(k + 1): record[channel][:, k] / size for k in range(6)}
    table = np.column_stack([1e3 * record.time, *columns.values()])
    file, found = tmp_path / "run.csv", tmp_path / "columns.toml"
    header = ";".join(["t_ms", *columns])
    np.savetxt(file, table, "%.5f", delimiter=";", header=header, comments="")
    cmf("recording", "new", file, "--file", found)
    found.write_text('machine = "lab"\n' + found.read_text())
    check = ("recording", "check", file, "--columns", found)
    assert "the recording fits the machine" in cmf(*check)
    # Of several each has a verdict, none is shown where one cannot be read.
    other, cut = tmp_path / "other.csv", tmp_path / "cut.csv"
    mixed = header.replace("x2_mm", "_").replace("x5_mm", "x2_mm").replace("_;", "x5_mm;", 1)
    np.savetxt(other, table, "%.5f", delimiter=";", header=mixed, comments="")
    cut.write_text(header)
    lines = " ".join(cmf(*check[:2], other, *check[2:], code=1).split())
    assert lines.startswith(f"{other}: leg_position: against leg_reference: legs 2 and 5 are exch")
    assert lines.endswith(f"{file}: the recording fits the machine 1 of 2 recordings fit lab")
    refused = cmf(*check, cut, code=2)
    assert "cut.csv" in refused and "fits the machine" not in refused
    found.write_text(found.read_text().replace('unit = "bar"', 'unit = "psi"'))
    assert "the file has bar where the map says psi" in " ".join(cmf(*check, code=1).split())
