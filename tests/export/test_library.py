"""A machine as a C library, beside the same run in Python."""

import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from cmf_mj import (
    Hexapod,
    Plant,
    Record,
    SingleLegs,
    drive,
    law_names,
    load_law,
    pose_to_legs,
    signals,
    simulate,
)
from cmf_mj.control.dcu.play import Arrivals
from cmf_mj.core.errors import InputError
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.export.header import ExportedChannel, channels
from cmf_mj.export.library import build, export_library
from cmf_mj.export.machine import make_export
from cmf_mj.facility.operation import operate
from cmf_mj.plant.events import KINDS, Event
from tests.plant.test_attach_excavator import excavator

HOST = Path(__file__).with_name("export_host.c")


def build_host(folder: Path) -> Path:
    command = ["cc", "-O2", "-std=gnu99", HOST, "-o", "host", "libcmf.so", "-Wl,-rpath,$ORIGIN"]
    subprocess.run([*command, "-I."], cwd=folder, check=True)
    return folder / "host"


def run_host(
    folder: Path, kind: str, every: int, rows: NDArray[np.float64], *event: object
) -> NDArray[np.float64]:
    """All channels of each step, by a process without environment."""
    rows.tofile(folder / "in.bin")
    command = [folder / "host", kind, every, folder / "in.bin", folder / "out.bin", *event]
    done = subprocess.run([str(word) for word in command], env={}, capture_output=True, text=True)
    assert not done.returncode, done.stderr
    return np.fromfile(folder / "out.bin")


def differing(
    table: list[ExportedChannel], values: NDArray[np.float64], record: Record
) -> list[str]:
    """Channels that are not those of the record, bit for bit; of the pose, not to 1e-14."""
    rows = values.reshape(-1, sum(channel.width for channel in table))
    differ, column = [], 0
    for name, _, width, _ in table:
        part = rows[:, column : column + width]
        column += width
        if name not in record.channels:
            continue
        expected = record[name].reshape(part.shape)
        if name == "platform_pose":
            same = bool(np.abs(part - expected).max() < 1e-14)
        else:
            same = part.tobytes() == expected.tobytes()
        differ += [] if same else [name]
    return differ


def export(plant: Plant, law: str, out: Path, noise: bool) -> tuple[Path, list[ExportedChannel]]:
    electronics = ElectronicsSettings() if noise else None
    out.mkdir(exist_ok=True)
    (out / "another.o").write_text("of another program in the same folder")
    export_library(plant, law, out, electronics=electronics)
    build_host(out)
    return out, channels(make_export(plant, load_law(law), electronics))


@pytest.fixture(scope="module")
def noisy(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[ExportedChannel]]:
    return export(Hexapod(), "velocity", tmp_path_factory.mktemp("noisy"), True)


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("CC", "no-such-compiler", "cc: there is no C compiler"),
        ("machine", "arm64", "system: Linux"),
    ],
)
def test_without_compiler_or_on_another_system_nothing_is_written(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, field: str, value: str, said: str
) -> None:
    if field == "CC":
        monkeypatch.setenv(field, value)
    else:
        monkeypatch.setattr("platform.machine", lambda: value)
    with pytest.raises(InputError, match=said):
        build({"cmf.h": ""}, tmp_path / "out", "libcmf.so", [])
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_the_library_needs_c_and_mujoco_alone(noisy: tuple[Path, list[ExportedChannel]]) -> None:
    library = noisy[0] / "libcmf.so"
    dynamic = subprocess.run(["readelf", "-dW", library], capture_output=True, text=True).stdout
    needed = {line.split("[")[1][:-1] for line in dynamic.splitlines() if "NEEDED" in line}
    assert needed == {"libc.so.6", "libm.so.6", next(noisy[0].glob("libmujoco.so.*")).name}
    assert "TEXTREL" not in dynamic
    names = subprocess.run(["nm", "-D", library], capture_output=True, text=True).stdout
    kinds = {line.split()[-2] for line in names.splitlines()}
    assert kinds <= {"T", "U", "w"}, "the library has data of its own: a global"


@pytest.mark.slow
def test_cmake_builds_the_example_and_the_machine_does_what_it_says(
    noisy: tuple[Path, list[ExportedChannel]],
) -> None:
    """It rises by a decimetre; from 2 s on, without pump, each stroke takes oil and pressure."""
    build = noisy[0] / "build"
    for command in (["cmake", "-S", noisy[0], "-B", build], ["cmake", "--build", build]):
        done = subprocess.run(command, capture_output=True, text=True)
        assert not done.returncode, done.stderr
    said = subprocess.run([build / "example"], env={}, capture_output=True, text=True).stdout
    rows = [line.split() for line in said.splitlines()]
    legs, supply = (np.array([float(row[place]) for row in rows]) for place in (4, 7))
    assert abs(legs[0]) < 1e-9 and 0.05 < legs.max() < 0.1
    assert supply[-1] < supply[4] - 0.1


@pytest.mark.slow
def test_a_minute_with_noise_is_the_record_bit_for_bit(
    noisy: tuple[Path, list[ExportedChannel]],
) -> None:
    folder, table = noisy
    time = np.arange(60 * 2048)[:, None] / 2048
    rates = 2.0 * np.pi * np.array([0.11, 0.23, 0.37, 0.41, 0.53, 0.61])
    sizes = np.array([0.2, 0.2, 0.1, 0.05, 0.05, 0.05])
    legs = pose_to_legs(sizes * (1.0 - np.exp(-time)) ** 3 * np.sin(rates * time))
    options = {"legs": True, "start": np.zeros(6), "protection": "default"}
    record = simulate(Hexapod(), "velocity", legs, electronics=ElectronicsSettings(), **options)
    assert differing(table, run_host(folder, "reference", 1, legs), record) == []


@pytest.mark.slow
def test_poses_give_the_legs_of_the_kinematics(noisy: tuple[Path, list[ExportedChannel]]) -> None:
    """The DCL's own leg demand against `pose_to_legs`, computed apart: round-off of 4 m."""
    folder, table = noisy
    pose = np.random.default_rng(1).uniform(-0.2, 0.2, (20, 6))
    rows = run_host(folder, "pose", 1, pose).reshape(20, -1)
    first = sum(c.width for c in table[: [c.name for c in table].index("leg_reference")])
    assert np.abs(rows[:, first : first + 6] - pose_to_legs(pose)).max() < 4e-15


@pytest.mark.slow
@pytest.mark.parametrize("plant", [Hexapod, SingleLegs])
def test_every_law_on_both_plants_through_a_failure(
    plant: Callable[[], Plant], tmp_path: Path
) -> None:
    """A valve goes hard over in a step of heave; protection is on."""
    legs = pose_to_legs(signals.step("heave", 0.02, at=0.2, duration=1.0).pose)
    event = Event(at=0.5, kind="valve_hard_over", leg=2, valve=1)
    words = (KINDS.index(event.kind), event.at, event.leg, event.valve, event.magnitude(0.0))
    options = {"legs": True, "start": np.zeros(6), "protection": "default", "events": [event]}
    for law in law_names("all"):
        folder, table = export(plant(), law, tmp_path / law, False)
        record = simulate(plant(), law, legs, **options)
        assert differing(table, run_host(folder, "reference", 1, legs, *words), record) == [], law


@pytest.mark.slow
def test_host_frames_go_through_the_whole_chain(noisy: tuple[Path, list[ExportedChannel]]) -> None:
    """Against `operate` on the same frames, late ones and refused ones among them."""
    folder, table = noisy
    count = 200
    time = np.arange(count) / 80.0
    sent = np.zeros((count, 3, 6))
    wave = np.array([np.sin(time), np.cos(time), -np.sin(time)]).T
    sent[:, :, 2], sent[:, :, 4] = 0.1 * wave, 0.05 * wave
    sent[50, 0, 2] = np.nan
    frame = np.round(time * 2048).astype(np.int64)
    frame[100:110] = frame[110]
    arrivals = Arrivals(frame, np.arange(count), time, sent)
    seconds = (frame[-1] + 205) / 2048
    operation = operate(Hexapod(), "velocity", arrivals, seconds=seconds)
    assert operation.rejections["not_finite"] == 1
    rows = np.column_stack([frame, np.arange(count), time, sent.reshape(count, 18)])
    assert differing(table, run_host(folder, "host", 1, rows), operation.record) == []


@pytest.mark.slow
def test_cylinders_of_any_model(tmp_path: Path) -> None:
    """The excavator, commanded at the valves: no platform, no law, no host."""
    plant = excavator()
    export_library(plant, None, tmp_path)
    build_host(tmp_path)
    table = channels(make_export(plant, None))
    valves = np.zeros((2048, plant.legs))
    valves[:, :2] = 0.1 * np.sin(np.arange(2048) / 300.0)[:, None]
    record = drive(plant, valves)
    assert differing(table, run_host(tmp_path, "reference", 1, valves), record) == []
