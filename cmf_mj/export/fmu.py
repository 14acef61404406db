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
from cmf_mj.export.header import ExportedChannel, channels, defines, parameters
from cmf_mj.export.library import Files, build, machine_files, sources
from cmf_mj.export.machine import Export, make_export
from cmf_mj.facility.signal import LegDemand, ValveCommands
from cmf_mj.machine.geometry import DOFS
from cmf_mj.plant.events import KINDS
from cmf_mj.plant.plant import Plant
from cmf_mj.record.record import Record

FAILURES = 4  #: Failures that parameters may name.

_BASE_UNITS = {
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

_FMI_2_TYPES = {"Float64": "Real", "Int32": "Integer", "Boolean": "Boolean"}
"""Types of variables in FMI 2, by those of FMI 3."""

_SECONDS, _STEPS = 1.0, 80  #: Length and steps a second of the reference result.


class Variable(NamedTuple):
    """A variable of the model description."""

    name: str
    kind: str  #: Float64, Int32 or Boolean.
    causality: str  #: input, parameter or output.
    text: str
    unit: str = ""
    start: float | None = None
    minimum: float | None = None
    maximum: float | None = None


def variables(export: Export) -> list[Variable]:
    """All variables of a machine in the order of their value references."""
    rows = [
        Variable(name, "Float64", "parameter", text, unit, start, minimum, maximum)
        for name, unit, text, start, minimum, maximum in parameters(export)
    ]
    text = "whether the inputs are frames of a host, 80 a second, through DCU and limits"
    host = Variable("host", "Boolean", "parameter", text, start=0)
    failures = _failure_parameters(export.plant.legs)
    return [*_inputs(export), *rows, host, *failures, *_outputs(export)]


def _failure_parameters(legs: int) -> list[Variable]:
    """Parameters of `FAILURES` failures, in the order of the C source."""
    kinds = "0 none, " + ", ".join(f"{n} {kind}" for n, kind in enumerate(KINDS, start=1))
    leg_text = "leg of a valve or sensor, 0 for the others"
    fields = (
        Variable("at", "Float64", "parameter", "when", "s", 0.0, 0.0, LONGEST),
        Variable("kind", "Int32", "parameter", kinds, "", 0.0, 0.0, len(KINDS)),
        Variable("leg", "Int32", "parameter", leg_text, "", 0.0, 0.0, legs),
        Variable("valve", "Int32", "parameter", "valve of the leg, 0 for both", "", 0.0, 0.0, 2),
        Variable("size", "Float64", "parameter", "how much, SI; 0 as the kind has it", "1", 0.0),
    )
    return [
        field._replace(name=f"failure[{number}].{field.name}")
        for number in range(1, FAILURES + 1)
        for field in fields
    ]


def _has_many_units(channel: ExportedChannel) -> bool:
    """Whether a channel is of generalised positions, which are no output."""
    return channel.unit.count(",") > 1


def _outputs(export: Export) -> list[Variable]:
    rows = []
    for channel in channels(export):
        if _has_many_units(channel):
            continue
        units, text = channel.unit.split(", "), channel.name.replace("_", " ")
        for index in range(channel.width):
            unit = units[index * len(units) // channel.width]
            name = channel.name + (f"[{index + 1}]" if channel.width > 1 else "")
            rows.append(Variable(name, "Float64", "output", text, unit))
    return rows


def _inputs(export: Export) -> list[Variable]:
    if not export.has_host:
        controller = export.parts.controller
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
    export = make_export(plant, None if law is None else load_law(law, plant.machine), electronics)
    table = variables(export)
    with tempfile.TemporaryDirectory() as folder, whole_file(file) as partial:
        work, root = Path(folder) / "work", Path(folder) / "fmu"
        token = f"{{{export.digest}}}"
        arguments = ["cmf.c", f"fmi{fmi}.c", "-DCMF_HIDDEN"]
        build(fmu_files(export, table), work, "cmf.so", arguments)
        binaries = root / "binaries" / ("linux64" if fmi == 2 else "x86_64-linux")
        binaries.mkdir(parents=True)
        for path in (work / "cmf.so", *work.glob("libmujoco.so.*")):
            shutil.copy(path, binaries)
        shutil.copytree(work / "licences", root / "documentation" / "licenses")
        tree = ElementTree.ElementTree(_model_description(export, table, fmi, token))
        ElementTree.indent(tree)
        tree.write(root / "modelDescription.xml", encoding="UTF-8", xml_declaration=True)
        _write_reference(export, table, root / "resources")
        with zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED) as archive:
            for path in sorted(path for path in root.rglob("*") if path.is_file()):
                archive.write(path, path.relative_to(root))
    return file


def fmu_files(export: Export, table: list[Variable]) -> Files:
    """All that an FMU is compiled of."""
    inputs = [variable for variable in table if variable.causality == "input"]
    starts = ", ".join(repr(variable.start) for variable in inputs)
    places = [
        f"{{{number}, {index}}}"
        for number, channel in enumerate(channels(export))
        for index in range(channel.width)
        if not _has_many_units(channel)
    ]
    numbers = {
        "TOKEN": f'"{{{export.digest}}}"',
        "CHAIN": int(export.has_host),
        "INPUTS": len(inputs),
        "PARAMETERS": len(parameters(export)),
        "FAILURES": FAILURES,
        "OUTPUTS": len(places),
    }
    lines = ["/* One machine as an FMU. */", *defines("FMU", numbers)]
    lines.append(f"static const double fmu_starts[] = {{{starts}}};")
    lines.append(f"static const short fmu_outputs[][2] = {{{', '.join(places)}}};\n")
    return machine_files(export) | sources("fmu") | {"cmf_fmu.h": "\n".join(lines)}


def _model_description(export: Export, table: list[Variable], fmi: int, token: str) -> Element:
    """The model description in a version of FMI."""
    plant, law = export.plant, export.session.describe()["law"]
    head = {
        "fmiVersion": f"{fmi}.0",
        "modelName": " ".join(filter(None, (plant.name, plant.cab, law))),
        "guid" if fmi == 2 else "instantiationToken": token,
        "description": f"Motion base with hydraulics and control law at {plant.machine.rate} Hz",
        "license": "MIT; documentation/licenses",
        "generationTool": f"cmf-mj {version('cmf-mj')}",
        "variableNamingConvention": "structured",
    }
    root, state = Element("fmiModelDescription", head), "FMUstate" if fmi == 2 else "FMUState"
    abilities = {"modelIdentifier": "cmf", "canHandleVariableCommunicationStepSize": "true"}
    abilities |= {f"canGetAndSet{state}": "true", f"canSerialize{state}": "true"}
    SubElement(root, "CoSimulation", abilities)
    units = SubElement(root, "UnitDefinitions")
    for name, powers in _BASE_UNITS.items():
        unit = SubElement(units, "Unit", name=name)
        SubElement(unit, "BaseUnit", {base: str(power) for base, power in powers.items()})
    categories, text = SubElement(root, "LogCategories"), "refusals, and with logging steps"
    SubElement(categories, "Category", name="logStatusError", description=text)
    times = {"startTime": "0", "stopTime": repr(_SECONDS), "stepSize": repr(1.0 / _STEPS)}
    SubElement(root, "DefaultExperiment", times)
    _add_variables(root, table, fmi)
    _add_structure(root, table, fmi)
    return root


def _add_variables(root: Element, table: list[Variable], fmi: int) -> None:
    """Add the variables; value references are their places in the table."""
    parent = SubElement(root, "ModelVariables")
    if fmi == 3:
        time = {"name": "time", "causality": "independent", "variability": "continuous"}
        SubElement(parent, "Float64", time, unit="s", valueReference=str(len(table)))
    for reference, variable in enumerate(table):
        place = {"valueReference": str(reference)}
        attributes, type_attributes = _attributes(variable), _type_attributes(variable)
        if fmi == 2:
            entry = SubElement(parent, "ScalarVariable", attributes, **place)
            SubElement(entry, _FMI_2_TYPES[variable.kind], type_attributes)
        else:
            SubElement(parent, variable.kind, attributes | type_attributes, **place)


def _add_structure(root: Element, table: list[Variable], fmi: int) -> None:
    """Add the outputs, each of which depends on the state alone."""
    structure = SubElement(root, "ModelStructure")
    outputs = [place for place, variable in enumerate(table) if variable.causality == "output"]
    independent = {"dependencies": ""}
    for name, attributes in (("Output", independent), ("InitialUnknown", dict[str, str]())):
        parent = SubElement(structure, f"{name}s") if fmi == 2 else structure
        for place in outputs:
            if fmi == 2:  # which counts from 1
                SubElement(parent, "Unknown", {"index": str(place + 1), **attributes})
            else:
                SubElement(parent, name, {"valueReference": str(place), **attributes})


def _attributes(variable: Variable) -> dict[str, str]:
    """Attributes of a variable of any type."""
    attributes = {
        "name": variable.name,
        "causality": variable.causality,
        "variability": "fixed" if variable.causality == "parameter" else "continuous",
        "description": variable.text,
    }
    if variable.causality != "input":
        attributes["initial"] = "calculated" if variable.causality == "output" else "exact"
    return attributes


def _type_attributes(variable: Variable) -> dict[str, str]:
    """Attributes that depend on the type of a variable."""
    attributes = {"unit": variable.unit} if variable.unit else {}
    is_integer = variable.kind != "Float64"
    numbers = {"start": variable.start, "min": variable.minimum, "max": variable.maximum}
    for name, value in numbers.items():
        if value is not None:
            attributes[name] = str(int(value)) if is_integer else repr(float(value))
    if variable.kind == "Boolean":
        attributes["start"] = "false"
    return attributes


def _write_reference(export: Export, table: list[Variable], folder: Path) -> None:
    """Write inputs, and what the Python loop makes of them, at every communication point."""
    points = np.arange(int(_SECONDS * _STEPS) + 1)
    frames = np.floor(points * export.plant.machine.rate / _STEPS + 0.5).astype(np.int64)  # as C
    inputs = [variable for variable in table if variable.causality == "input"]
    values = np.tile([variable.start or 0.0 for variable in inputs], (points.size, 1))
    column = 2 if export.has_host else 0  # heave, or the first actuator
    values[:, column] += 0.02 * np.sin(2.0 * np.pi * points / _STEPS) ** 3
    record = _run_python_loop(export, np.repeat(values[:-1], np.diff(frames), axis=0))
    rows, output_channels = np.maximum(frames - 1, 0), ("leg_extension", "valve_command")
    outputs = np.concatenate([record[name][rows] for name in output_channels], axis=1)
    legs = range(1, export.plant.legs + 1)
    output_names = [f"{name}[{leg}]" for name in output_channels for leg in legs]
    _write_table(folder / "reference_in.csv", [variable.name for variable in inputs], values)
    _write_table(folder / "reference_out.csv", output_names, outputs)


def _write_table(path: Path, names: list[str], values: NDArray[np.float64]) -> None:
    """Write columns at every communication point, (N, n), behind their time."""
    time = np.arange(len(values))[:, None] / _STEPS
    write_csv(path, ["time", *names], np.concatenate([time, values], axis=1).tolist(), digits=17)


def _run_python_loop(export: Export, rows: NDArray[np.float64]) -> Record:
    """The Python loop on inputs that a row a frame has."""
    duration = rows.shape[0] * export.plant.machine.frame
    source = LegDemand(rows) if export.run.law else ValveCommands(rows)
    run = export.run.changed(duration=duration, operation=None, source=source)
    if not export.has_host:
        return run.record()
    geometry = export.plant.machine.geometry
    motion, legs = np.zeros((2, 3, 6))
    leg_demand = np.empty((rows.shape[0], 6))
    for frame, pose in enumerate(rows[:, :6]):
        motion[0] = pose
        demand.step(geometry, motion, legs)
        leg_demand[frame] = legs[0]
    return run.changed(source=LegDemand(leg_demand), start=np.zeros(6)).record()
