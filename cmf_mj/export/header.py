"""What the C source must know of one machine: its header, and its data as bytes."""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.law import SIGNALS
from cmf_mj.control.states import Request
from cmf_mj.core.errors import InputError
from cmf_mj.core.units import LONGEST, MOST_FRAMES
from cmf_mj.export.machine import ARRIVALS, EVENTS, Export
from cmf_mj.plant.events import KINDS, default_event
from cmf_mj.plant.hydraulics import ENERGIES
from cmf_mj.plant.oil import ATMOSPHERE
from cmf_mj.plant.supply import ACCUMULATOR, GAS


class ExportedParameter(NamedTuple):
    """A number that a host may set before the first frame."""

    name: str
    unit: str
    text: str
    start: float
    minimum: float
    maximum: float


class ExportedChannel(NamedTuple):
    """A channel as a host reads it."""

    name: str
    unit: str
    width: int
    first: int  #: Column of the loop's row; -1 for the platform's pose.


def parameters(export: Export) -> list[ExportedParameter]:
    """All parameters of a machine in the order of the C source."""
    supply, plant = export.parts.dynamics.hydraulics.supply, export.plant
    lowest_pressure = 0.1 * supply.pressure if supply.constant else supply.precharge
    protection = float(export.parts.controller.guarded)
    text = "1: faults make an emergency stop"
    pressures = supply.pressure, lowest_pressure, supply.relief_pressure
    rows = [
        ExportedParameter("settle", "s", "rest after a change of parameters", 5.0, 0.0, 60.0),
        ExportedParameter("protection", "1", text, protection, 0.0, 1.0),
        ExportedParameter("supply.pressure", "Pa", "set pressure", *pressures),
    ]
    for name in SIGNALS:
        text = f"factor on the law's gains of {name}"
        rows.append(ExportedParameter(f"gain.{name}", "1", text, 1.0, -10.0, 10.0))
    if (body := payload_body(export)) >= 0:
        mass = float(plant.model.body_mass[body])
        low, high = 0.1 * mass, 4.0 * mass
        rows.append(ExportedParameter("payload.mass", "kg", "of the cab", mass, low, high))
        for axis, value in zip("xyz", plant.model.body_ipos[body].tolist(), strict=True):
            text = f"centre of mass of the cab, {axis} of x forward, y left, z up"
            rows.append(ExportedParameter(f"payload.{axis}", "m", text, value, -5.0, 5.0))
    return rows


def payload_body(export: Export) -> int:
    """Body of the cab in the model, -1 where there is none."""
    return int(mujoco.mj_name2id(export.plant.model, mujoco.mjtObj.mjOBJ_BODY, "cab/cab"))


def channels(export: Export) -> list[ExportedChannel]:
    """All channels of a machine, the pose of a platform last."""
    rows = [
        ExportedChannel(channel.name, channel.unit, channel.width or 1, channel.first)
        for channel in export.session.layout.channels
    ]
    if platform_joint(export) >= 0:
        rows.append(ExportedChannel("platform_pose", "m, rad", 6, -1))
    return rows


def platform_joint(export: Export) -> int:
    """First generalised position of the platform, -1 where there is none."""
    model = export.plant.model
    joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, "platform")
    return int(model.jnt_qposadr[joint]) if joint >= 0 else -1


def contents(export: Export) -> tuple[dict[str, NDArray[np.uint8]], str]:
    """Constant bytes by their C names, and the text of `cmf_machine.h`."""
    parameter_rows, channel_rows = parameters(export), channels(export)
    starts = np.array([parameter.start for parameter in parameter_rows])
    inertia = export.plant.model.body_inertia[payload_body(export)].tolist()
    half_stroke = export.plant.machine.half_stroke
    failure_rows = (_failure_row(kind, half_stroke) for kind in KINDS)
    slots = {path.replace(".", "_"): slot for path, slot in export.image.first_slots.items()}
    lines = [
        "/* One machine, as exported. */",
        *defines("CMF", _numbers(export, parameter_rows, channel_rows)),
        *defines("AT", slots),
        _c_array("int cmf_pointers", map(str, export.image.pointers)),
        _c_array("double cmf_starts", map(repr, starts.tolist())),
        _c_array("double cmf_inertia", map(repr, inertia)),
        _c_array("cmf_channel_info cmf_channel_table", map(_c_row, channel_rows)),
        _c_array("cmf_parameter_info cmf_parameter_table", map(_c_row, parameter_rows)),
        _c_array("cmf_failure_info cmf_failure_table", failure_rows),
    ]
    for request in Request:
        is_equal = f"CMF_REQUEST_{request.name} == {request.value}"
        lines.append(f"typedef char cmf_{request.name.lower()}_is_that[{is_equal} ? 1 : -1];")
    return _blocks(export, starts), "\n".join([*lines, ""])


def _blocks(export: Export, starts: NDArray[np.float64]) -> dict[str, NDArray[np.uint8]]:
    """Constant bytes by their C names; a machine in memory begins as `cmf_start_data` says."""
    image = export.image
    # `head_t` of `cmf.c` up to its parameters: digest, machine, and five numbers that begin at 0.
    head = np.array([0, int(export.digest, 16), 0, 0, 0, 0, 0], dtype=np.int64)
    warnings = np.zeros(2 * int(mujoco.mjtWarning.mjNWARNING), dtype=np.int32)
    mechanics, sensors = export.mechanics, export.sensors
    return {
        "cmf_slots_data": _bytes(image.slots),
        "cmf_arena_data": image.block,
        "cmf_model_data": export.model,
        "cmf_start_data": _bytes(head, starts, mechanics, sensors, warnings, image.block),
    }


_DEMAND_BEGIN, _DEMAND_END = "blocks.geometry.upper", "blocks.states.fade"
"""Paths in the controller's source: slots between them make leg demands of host frames."""


def _numbers(
    export: Export, parameter_rows: list[ExportedParameter], channel_rows: list[ExportedChannel]
) -> dict[str, object]:
    """Numbers that the C source knows by name: sizes, places and what the machine has."""
    image = export.image
    columns = {channel.name: channel.first for channel in channel_rows}
    joint = platform_joint(export)
    numbers: dict[str, object] = {
        "MUJOCO": mujoco.mj_version(),
        "DIGEST": f"{int(export.digest, 16)}u",
        "SLOTS": image.slots.size,
        "ARENA": image.block.size,
        "MODEL": export.model.size,
        "MECHANICS": export.mechanics.size,
        "SENSORS": export.sensors.size,
        "LEGS": export.plant.legs,
        "CHAIN": int(export.has_host),
        "ARRIVALS": ARRIVALS,
        "EVENTS": EVENTS,
        "MOST": MOST_FRAMES,
        "LONGEST": repr(LONGEST),
        "SIGNALS": len(SIGNALS),
        "ENERGIES": len(ENERGIES),
        "ENERGY_COLUMN": columns["energy"],
        "PLATFORM": -1 if joint < 0 else columns["generalised_position"] + joint,
        "BODY": payload_body(export),
        "ACCUMULATORS": int(not export.parts.dynamics.hydraulics.supply.constant),
        "SUPPLY_OIL": ACCUMULATOR,
        "SUPPLY_GAS": GAS,
        "ATMOSPHERE": repr(ATMOSPHERE),
        "PARAMETERS": len(parameter_rows),
    }
    for number, parameter in enumerate(parameter_rows):
        numbers[f"P_{_upper(parameter.name)}"] = number
    first_signal, *_ = SIGNALS
    numbers["P_GAIN"] = numbers[f"P_GAIN_{_upper(first_signal)}"]
    if export.has_host:
        begin = image.first_slots[f"controller.source.{_DEMAND_BEGIN}"]
        numbers["DEMAND_SLOTS"] = image.first_slots[f"controller.source.{_DEMAND_END}"] - begin
    return numbers


def defines(prefix: str, numbers: Mapping[str, object]) -> list[str]:
    """Lines of a header that define numbers."""
    return [f"#define {prefix}_{name} {value}" for name, value in numbers.items()]


def _upper(name: str) -> str:
    return name.replace(".", "_").upper()


def _c_array(name: str, rows: Iterable[str]) -> str:
    return f"static const {name}[] = {{\n  " + ",\n  ".join(rows) + "};"


def _c_row(values: Iterable[object]) -> str:
    cells = (f'"{value}"' if isinstance(value, str) else repr(value) for value in values)
    return "{" + ", ".join(cells) + "}"


def _failure_row(kind: str, half_stroke: float) -> str:
    """A kind of failure: its unit, whether it names a leg and a valve, and its usual size."""
    event, unit = default_event(kind, 0.0), ""
    for candidate in ("1", "N", "m", "m^2"):
        with suppress(InputError):
            default_event(kind, 0.0, size=(1.0, candidate))
            unit = candidate
    has_leg, has_valve = int(event.leg is not None), int(kind.startswith("valve"))
    return _c_row([kind, unit, has_leg, has_valve, event.magnitude(half_stroke)])


def _bytes(*arrays: NDArray[Any]) -> NDArray[np.uint8]:
    return np.frombuffer(b"".join(array.tobytes() for array in arrays), dtype=np.uint8)
