"""Machines as FMUs, run by FMPy beside the Python loop; the C part under AddressSanitizer."""

import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from crosscheck.second import by_cosim, by_ecos, played
from fmpy import read_model_description
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu
from hypothesis import given, settings
from hypothesis import strategies as st
from lengths import examples

from cmf_mj import Hexapod, load_law
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.export.fmu import export_fmu, fmu_files, variables
from cmf_mj.export.library import write_files
from cmf_mj.export.machine import make_export

pytestmark = pytest.mark.slow
FUZZ = Path(__file__).with_name("export_fuzz.c")


@pytest.fixture(scope="module", params=[2, 3])
def file(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A machine with noise, in both versions."""
    target = tmp_path_factory.mktemp("fmu") / "cmf.fmu"
    return export_fmu(
        Hexapod(), "velocity", target, fmi=request.param, electronics=ElectronicsSettings()
    )


class Slave:
    """An instance by FMPy, the same for both versions."""

    def __init__(self, folder: Path, file: Path, **start: float) -> None:
        described = read_model_description(file)
        self.two = described.fmiVersion == "2.0"
        self.reference = {v.name: v.valueReference for v in described.modelVariables}
        kind = FMU2Slave if self.two else FMU3Slave
        guid = described.guid if self.two else described.instantiationToken
        self.fmu: Any = kind(
            guid=guid, unzipDirectory=str(folder), modelIdentifier="cmf", instanceName="one"
        )
        self.said: list[str] = []
        self.fmu.instantiate(loggingOn=False)
        self.begin(**start)

    def begin(self, **start: float) -> None:
        if self.two:
            self.fmu.setupExperiment(startTime=0.0)
            self.set(**start)
            self.fmu.enterInitializationMode()
        else:
            self.set(**start)
            self.fmu.enterInitializationMode(startTime=0.0)
        self.fmu.exitInitializationMode()

    def set(self, **values: float) -> None:
        setter = self.fmu.setReal if self.two else self.fmu.setFloat64
        for name, value in values.items():
            setter([self.reference[name]], [value])

    def get(self, *names: str) -> list[float]:
        getter = self.fmu.getReal if self.two else self.fmu.getFloat64
        return list(getter([self.reference[name] for name in names]))

    def step(self, time: float, size: float) -> None:
        self.fmu.doStep(currentCommunicationPoint=time, communicationStepSize=size)

    def legs(self) -> list[float]:
        return self.get(*(f"leg_extension[{leg}]" for leg in range(1, 7)))

    def run(self, first: int, last: int, rate: float = 80.0) -> list[list[float]]:
        """Legs at the 80 Hz points, the demand held from one to the next."""
        found = []
        times = np.arange(round(first * rate / 80.0), round(last * rate / 80.0) + 1) / rate
        due = first
        for time, following in zip(times, times[1:], strict=False):
            if time >= due / 80.0 - 1e-9:
                self.set(**{"demand.heave": 0.02 * np.sin(due / 5.0)})
                due += 1
            self.step(time, following - time)
            if abs(following * 80.0 - round(following * 80.0)) < 1e-9:
                found.append(self.legs())
        return found


@pytest.fixture
def folder(file: Path, tmp_path: Path) -> Path:
    fmpy.extract(str(file), str(tmp_path))
    return tmp_path


def test_the_validator_has_nothing_to_say(file: Path) -> None:
    assert validate_fmu(str(file)) == []


def test_the_reference_result_of_the_python_loop_comes_back(file: Path, folder: Path) -> None:
    given, expected = (
        np.genfromtxt(folder / "resources" / f"reference_{part}.csv", delimiter=",", names=True)
        for part in ("in", "out")
    )
    slave = Slave(folder, file)
    names = (folder / "resources" / "reference_in.csv").read_text().split("\n")[0].split(",")[1:]
    for row, after in zip(given, list(expected)[1:], strict=False):
        slave.set(**dict(zip(names, list(row)[1:], strict=True)))
        slave.step(row["time"], after["time"] - row["time"])
        assert np.array(slave.legs()).tobytes() == np.array(list(after)[1:7]).tobytes()


@pytest.mark.parametrize(
    ("file", "importer"), [(2, by_cosim), (2, by_ecos), (3, by_ecos)], indirect=["file"]
)
def test_a_second_importer_has_the_same_bits(file: Path, importer: Any, tmp_path: Path) -> None:
    """FMI Library of Modelon, which takes version 2, and fmi4c, which takes both."""
    assert played(file, tmp_path, importer) == 0.0


def test_a_state_that_is_restored_goes_on_with_the_same_bits(file: Path, folder: Path) -> None:
    slave, other = Slave(folder, file), None
    slave.run(0, 20)
    save = slave.fmu.getFMUstate if slave.two else slave.fmu.getFMUState
    load = slave.fmu.setFMUstate if slave.two else slave.fmu.setFMUState
    state = save()
    wire = (slave.fmu.serializeFMUstate if slave.two else slave.fmu.serializeFMUState)(state)
    once = slave.run(20, 40)
    load(state)
    assert slave.run(20, 40) == once
    other = Slave(folder, file)
    read = other.fmu.deSerializeFMUstate if other.two else other.fmu.deserializeFMUState
    (other.fmu.setFMUstate if other.two else other.fmu.setFMUState)(read(wire))
    assert other.run(20, 40) == once


def test_two_instances_leave_each_other_alone(file: Path, folder: Path) -> None:
    alone = Slave(folder, file).run(0, 20)
    first, second = Slave(folder, file), Slave(folder, file)
    second.set(**{"demand.surge": 0.1})
    mixed = []
    for step in range(20):
        mixed += first.run(step, step + 1)
        second.run(step, step + 1)
    assert mixed == alone
    assert second.legs() != first.legs()


def test_80_and_2048_hz_agree_where_both_communicate(file: Path, folder: Path) -> None:
    """Every 5/80 s is a frame of 2048 Hz: the demand changes there alone."""
    results = []
    for rate, every in ((80.0, 5), (2048.0, 128)):
        slave, found = Slave(folder, file), []
        for number in range(every * 10):
            if number % every == 0:
                slave.set(**{"demand.heave": 0.02 * np.sin(number / every)})
            slave.step(number / rate, 1.0 / rate)
            if (number + 1) % every == 0:
                found.append(slave.legs())
        results.append(found)
    assert results[0] == results[1]


@pytest.mark.parametrize(
    "wrong",
    [
        {"payload.mass": -1.0},
        {"supply.pressure": 1e12},
        {"gain.velocity": float("nan")},
        {"leg_extension[1]": 1.0},
    ],
)
def test_a_wrong_parameter_is_an_error_and_no_crash(
    file: Path, folder: Path, wrong: dict[str, float]
) -> None:
    with pytest.raises(Exception, match="status 3|error|Error"):
        Slave(folder, file, **wrong)


def test_a_step_backwards_is_an_error_and_the_machine_goes_on(file: Path, folder: Path) -> None:
    slave = Slave(folder, file)
    expected = Slave(folder, file).run(0, 4)
    slave.run(0, 2)
    for time, size in ((0.0, 0.0125), (0.025, -0.0125), (0.025, float("nan"))):
        with pytest.raises(Exception, match="status 3|error|Error"):
            slave.step(time, size)
    assert slave.run(2, 4) == expected[2:]


def test_it_needs_nothing_of_its_resources(file: Path, folder: Path) -> None:
    for path in (folder / "resources").iterdir():
        path.unlink()
    assert len(Slave(folder, file).run(0, 2)) == 2


def test_a_heavier_cab_comes_to_rest_where_python_puts_it(file: Path, folder: Path) -> None:
    """Against a plant built with that cab: pressures at rest carry half as much again."""
    light = Hexapod()
    assert light.cab_parameters is not None
    cab = light.cab_parameters.changed("heavy", mass=1.5 * light.cab_parameters.mass.si)
    slave = Slave(folder, file, **{"payload.mass": cab.mass.si, "settle": 20.0})
    rest = Hexapod(cab).start(np.zeros(6))
    area = Hexapod(cab).hydraulics.cylinder
    force = np.array(slave.get(*(f"leg_force[{leg}]" for leg in range(1, 7))))
    held = rest.pressure[:, 0] * area.cap_area - rest.pressure[:, 1] * area.rod_area
    assert np.abs(force - held).max() < 0.01 * np.abs(held).max()
    before = light.start(np.zeros(6)).pressure
    empty = before[:, 0] * area.cap_area - before[:, 1] * area.rod_area
    assert np.abs(held - empty).min() > 0.05 * np.abs(held).max()


@pytest.fixture(scope="module")
def driver(tmp_path_factory: pytest.TempPathFactory) -> Iterator[subprocess.Popen[bytes]]:
    """A process that calls an FMU as it is told, under AddressSanitizer."""
    out = tmp_path_factory.mktemp("fuzz")
    frozen = make_export(Hexapod(), load_law("velocity"), ElectronicsSettings())
    write_files(fmu_files(frozen, variables(frozen)), out)
    command = ["cc", "-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    command += ["-I.", "-isystem", "include", FUZZ, "cmf.c", *sorted(out.glob("*.o")), "-o", "fuzz"]
    command += [next(out.glob("libmujoco.so.*")).name, "-lm", "-Wl,-rpath,$ORIGIN"]
    subprocess.run(command, cwd=out, check=True)
    process = subprocess.Popen([out / "fuzz"], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    yield process
    assert process.stdin is not None and process.stdout is not None
    process.stdin.close()
    process.stdout.close()
    assert process.wait(60) == 0, "memory was not given back"


@pytest.mark.fuzz
@given(calls=st.binary(min_size=1, max_size=400))
@settings(max_examples=examples(4_000), deadline=None)
def test_no_order_of_calls_breaks_memory(driver: subprocess.Popen[bytes], calls: bytes) -> None:
    assert driver.stdin is not None and driver.stdout is not None
    driver.stdin.write(len(calls).to_bytes(2, "little") + calls)
    driver.stdin.flush()
    assert driver.stdout.read(1) == b"."
