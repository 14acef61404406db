"""`cmf export fmu`: a machine as a Functional Mock-up Unit for co-simulation, FMI 2.0 or 3.0.

Inputs are the demand of the platform, or references of the actuators of any other plant; outputs
are all channels; parameters those of the library and some failures. Value references count in the
order of `variables`, as the C source does.
"""

import shutil
import tempfile
import zipfile
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control import demand
from cmf_mj.control.law import Law, load_law
from cmf_mj.core.errors import InputError
from cmf_mj.core.files import whole_file
from cmf_mj.core.tables import write_csv
from cmf_mj.core.units import LONGEST
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.export.header import channels, defines, parameters
from cmf_mj.export.library import Files, machine_files, make, sources
from cmf_mj.export.machine import Frozen, freeze
from cmf_mj.facility.signal import LegDemand, ValveCommands
from cmf_mj.machine.geometry import DOFS
from cmf_mj.plant.events import KINDS
from cmf_mj.plant.plant import Plant
from cmf_mj.record.record import Record

FAILURES = 4  #: Failures that parameters may name.

_BASE = {
    "1": {},
    "s": {"s": 1},
    "m": {"m": 1},
    "kg": {"kg": 1},
    "rad": {"rad": 1},
    "m/s": {"m": 1, "s": -1},
    "rad/s": {"rad": 1, "s": -1},
    "m/s^2": {"m": 1, "s": -2},
    "rad/s^2": {"rad": 1, "s": -2},
    "m^3": {"m": 3},
    "m^3/s": {"m": 3, "s": -1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
}
"""Units by their SI base units."""

_OF_FMI_2 = {"Float64": "Real", "Int32": "Integer", "Boolean": "Boolean"}
"""Kinds of variables in FMI 2."""

_SECONDS, _STEPS = 1.0, 80  #: Length and steps a second of the reference result.


class Variable(NamedTuple):
    """A variable of the model description."""

    name: str
    kind: str  #: Float64, Int32 or Boolean.
    causality: str  #: input, parameter or output.
    text: str
    unit: str = ""
    start: float | None = None
    least: float | None = None
    most: float | None = None


def variables(frozen: Frozen) -> list[Variable]:
    """All variables of a machine in the order of their value references."""
    listed = _inputs(frozen)
    for name, unit, text, start, least, most in parameters(frozen):
        listed.append(Variable(name, "Float64", "parameter", text, unit, start, least, most))
    text = "whether the inputs are frames of a host, 80 a second, through DCU and limits"
    listed.append(Variable("host", "Boolean", "parameter", text, start=0))
    kinds = "0 none, " + ", ".join(f"{n} {kind}" for n, kind in enumerate(KINDS, start=1))
    legs = frozen.plant.legs
    for number in range(1, FAILURES + 1):
        rows: list[tuple[str, str, str, str, float | None]] = [
            ("at", "Float64", "s", "when", LONGEST),
            ("kind", "Int32", "", kinds, len(KINDS)),
            ("leg", "Int32", "", "leg of a valve or sensor, 0 for the others", legs),
            ("valve", "Int32", "", "valve of the leg, 0 for both", 2),
            ("size", "Float64", "1", "how much, SI; 0 as the kind has it", None),
        ]
        for name, kind, unit, said, high in rows:
            low = None if high is None else 0.0
            where = f"failure[{number}].{name}"
            listed.append(Variable(where, kind, "parameter", said, unit, 0.0, low, high))
    for channel in channels(frozen):
        units = channel.unit.split(", ")
        if len(units) == 3:  # generalised positions
            continue
        for index in range(channel.width):
            unit = units[index * len(units) // channel.width]
            name = channel.name + (f"[{index + 1}]" if channel.width > 1 else "")
            text = channel.name.replace("_", " ")
            listed.append(Variable(name, "Float64", "output", text, unit))
    return listed


def _inputs(frozen: Frozen) -> list[Variable]:
    if not frozen.chain:
        controller = frozen.parts.controller
        text, unit = "valve command, fraction", "1"
        if controller.closed:
            text, unit = "extension asked of an actuator", "m"
        return [
            Variable(f"reference[{leg}]", "Float64", "input", text, unit, float(value))
            for leg, value in enumerate(controller.source.table[0], start=1)
        ]
    return [
        Variable(f"{name}.{dof}", "Float64", "input", f"{text}, z down", unit + per, 0.0)
        for name, text, per in (
            ("demand", "platform demand", ""),
            ("demand_velocity", "its velocity, for a host", "/s"),
            ("demand_acceleration", "its acceleration, for a host", "/s^2"),
        )
        for dof, unit in zip(DOFS, ["m"] * 3 + ["rad"] * 3, strict=True)
    ]


def export_fmu(
    plant: Plant,
    law: str | Path | Law | None,
    file: Path,
    *,
    fmi: int = 2,
    electronics: ElectronicsSettings | None = None,
) -> Path:
    """Write a machine as an FMU of FMI 2 or 3; arguments and errors as of `export_library`."""
    if fmi not in (2, 3):
        raise InputError(f"fmi: {fmi} is refused; allowed: 2, 3")
    frozen = freeze(plant, None if law is None else load_law(law, plant.machine), electronics)
    listed = variables(frozen)
    with tempfile.TemporaryDirectory() as folder, whole_file(file) as partial:
        work, root = Path(folder) / "work", Path(folder) / "fmu"
        token = f"{{{frozen.digest}}}"
        make(fmu_files(frozen, listed), work, "cmf.so", ["cmf.c", f"fmi{fmi}.c", "-DCMF_HIDDEN"])
        binaries = root / "binaries" / ("linux64" if fmi == 2 else "x86_64-linux")
        binaries.mkdir(parents=True)
        for path in (work / "cmf.so", *work.glob("libmujoco.so.*")):
            shutil.copy(path, binaries)
        shutil.copytree(work / "licences", root / "documentation" / "licenses")
        tree = ElementTree.ElementTree(_described(frozen, listed, fmi, token))
        ElementTree.indent(tree)
        tree.write(root / "modelDescription.xml", encoding="UTF-8", xml_declaration=True)
        _write_reference(frozen, listed, root / "resources")
        with zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED) as archive:
            for path in sorted(path for path in root.rglob("*") if path.is_file()):
                archive.write(path, path.relative_to(root))
    return file


def fmu_files(frozen: Frozen, listed: list[Variable]) -> Files:
    """All that an FMU is compiled of."""
    count = {c: sum(v.causality == c for v in listed) for c in ("input", "output")}
    starts = ", ".join(repr(v.start) for v in listed if v.causality == "input")
    places = [
        f"{{{number}, {index}}}"
        for number, channel in enumerate(channels(frozen))
        for index in range(channel.width)
        if channel.unit.count(",") < 2
    ]
    numbers = {
        "TOKEN": f'"{{{frozen.digest}}}"',
        "CHAIN": int(frozen.chain),
        "INPUTS": count["input"],
        "PARAMETERS": len(parameters(frozen)),
        "FAILURES": FAILURES,
        "OUTPUTS": count["output"],
    }
    lines = ["/* One machine as an FMU. */", *defines("FMU", numbers)]
    lines.append(f"static const double fmu_starts[] = {{{starts}}};")
    lines.append(f"static const short fmu_outputs[][2] = {{{', '.join(places)}}};\n")
    return machine_files(frozen) | sources("fmu") | {"cmf_fmu.h": "\n".join(lines)}


def _described(frozen: Frozen, listed: list[Variable], fmi: int, token: str) -> Element:
    """The model description in a version of FMI."""
    state = "FMUstate" if fmi == 2 else "FMUState"
    plant, law = frozen.plant, frozen.session.describe()["law"]
    head = {
        "fmiVersion": f"{fmi}.0",
        "modelName": " ".join(filter(None, (plant.name, plant.cab, law))),
        "guid" if fmi == 2 else "instantiationToken": token,
        "description": f"Motion base with hydraulics and control law at {plant.machine.rate} Hz",
        "license": "MIT; documentation/licenses",
        "generationTool": f"cmf-mj {version('cmf-mj')}",
        "variableNamingConvention": "structured",
    }
    root = Element("fmiModelDescription", head)
    able = {"modelIdentifier": "cmf", "canHandleVariableCommunicationStepSize": "true"}
    able |= {f"canGetAndSet{state}": "true", f"canSerialize{state}": "true"}
    SubElement(root, "CoSimulation", able)
    units = SubElement(root, "UnitDefinitions")
    for name, powers in _BASE.items():
        unit = SubElement(units, "Unit", name=name)
        SubElement(unit, "BaseUnit", {base: str(power) for base, power in powers.items()})
    logged = SubElement(root, "LogCategories")
    SubElement(
        logged, "Category", name="logStatusError", description="refusals, and with logging steps"
    )
    times = {"startTime": "0", "stopTime": repr(_SECONDS), "stepSize": repr(1.0 / _STEPS)}
    SubElement(root, "DefaultExperiment", times)
    table, structure = SubElement(root, "ModelVariables"), SubElement(root, "ModelStructure")
    if fmi == 3:
        time = {"name": "time", "causality": "independent", "variability": "continuous"}
        SubElement(table, "Float64", time, unit="s", valueReference=str(len(listed)))
    for reference, variable in enumerate(listed):
        (said, kind), place = _attributes(variable), str(reference)
        if fmi == 2:
            entry = SubElement(table, "ScalarVariable", said, valueReference=place)
            SubElement(entry, _OF_FMI_2[variable.kind], kind)
        else:
            SubElement(table, variable.kind, said | kind, valueReference=place)
    outputs = [n for n, variable in enumerate(listed) if variable.causality == "output"]
    for name, more in (("Output", {"dependencies": ""}), ("InitialUnknown", {})):
        part = SubElement(structure, f"{name}s") if fmi == 2 else structure
        for n in outputs:
            if fmi == 2:
                SubElement(part, "Unknown", {"index": str(n + 1), **more})
            else:
                SubElement(part, name, {"valueReference": str(n), **more})
    return root


def _attributes(variable: Variable) -> tuple[dict[str, str], dict[str, str]]:
    """Of a variable in both versions, and of its type."""
    varies = "continuous" if variable.causality != "parameter" else "fixed"
    said = {
        "name": variable.name,
        "causality": variable.causality,
        "variability": varies,
        "description": variable.text,
    }
    if variable.causality != "input":
        said["initial"] = "calculated" if variable.causality == "output" else "exact"
    kind = {"unit": variable.unit} if variable.unit else {}
    integer = variable.kind != "Float64"
    for name, value in (("start", variable.start), ("min", variable.least), ("max", variable.most)):
        if value is not None:
            kind[name] = str(int(value)) if integer else repr(float(value))
    if variable.kind == "Boolean":
        kind["start"] = "false"
    return said, kind


def _write_reference(frozen: Frozen, listed: list[Variable], folder: Path) -> None:
    """Write inputs, and what the Python loop makes of them, at every communication point."""
    points = np.arange(int(_SECONDS * _STEPS) + 1)
    frame = np.floor(points * frozen.plant.machine.rate / _STEPS + 0.5).astype(np.int64)  # as C
    inputs = [variable for variable in listed if variable.causality == "input"]
    given = np.tile([variable.start or 0.0 for variable in inputs], (points.size, 1))
    given[:, 2 if frozen.chain else 0] += 0.02 * np.sin(2.0 * np.pi * points / _STEPS) ** 3
    record = _run(frozen, np.repeat(given[:-1], np.diff(frame), axis=0))
    at, channels_read = np.maximum(frame - 1, 0), ("leg_extension", "valve_command")
    found = np.concatenate([record[name][at] for name in channels_read], axis=1)
    legs = range(1, frozen.plant.legs + 1)
    names = [f"{name}[{leg}]" for name in channels_read for leg in legs]
    time = points[:, None] / _STEPS
    for name, header, values in (("in", [v.name for v in inputs], given), ("out", names, found)):
        rows = np.concatenate([time, values], axis=1).tolist()
        write_csv(folder / f"reference_{name}.csv", ["time", *header], rows, digits=17)


def _run(frozen: Frozen, rows: NDArray[np.float64]) -> Record:
    """The Python loop on inputs that a row a frame has."""
    duration = rows.shape[0] * frozen.plant.machine.frame
    source = LegDemand(rows) if frozen.run.law else ValveCommands(rows)
    run = frozen.run.changed(duration=duration, operation=None, source=source)
    if not frozen.chain:
        return run.record()
    geometry = frozen.plant.machine.geometry
    motion, legs = np.zeros((2, 3, 6))
    table = np.empty((rows.shape[0], 6))
    for frame, pose in enumerate(rows[:, :6]):
        motion[0] = pose
        demand.step(geometry, motion, legs)
        table[frame] = legs[0]
    return run.changed(source=LegDemand(table), start=np.zeros(6)).record()
