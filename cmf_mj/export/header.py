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
from cmf_mj.export.machine import ARRIVALS, EVENTS, Frozen
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
    least: float
    most: float


class ExportedChannel(NamedTuple):
    """A channel as a host reads it."""

    name: str
    unit: str
    width: int
    first: int  #: Column of the loop's row; -1 for the platform's pose.


def parameters(frozen: Frozen) -> list[ExportedParameter]:
    """All parameters of a machine in the order of the C source."""
    supply, plant = frozen.parts.dynamics.hydraulics.supply, frozen.plant
    low = 0.1 * supply.pressure if supply.constant else supply.precharge
    guarded, high = float(frozen.parts.controller.guarded), supply.relief_pressure
    listed = [
        ExportedParameter("settle", "s", "rest after a change of parameters", 5.0, 0.0, 60.0),
        ExportedParameter("protection", "1", "1: faults make an emergency stop", guarded, 0.0, 1.0),
        ExportedParameter("supply.pressure", "Pa", "set pressure", supply.pressure, low, high),
    ]
    for name in SIGNALS:
        text = f"factor on the law's gains of {name}"
        listed.append(ExportedParameter(f"gain.{name}", "1", text, 1.0, -10.0, 10.0))
    if (body := payload_body(frozen)) >= 0:
        mass = float(plant.model.body_mass[body])
        listed.append(
            ExportedParameter("payload.mass", "kg", "of the cab", mass, 0.1 * mass, 4.0 * mass)
        )
        for axis, value in zip("xyz", plant.model.body_ipos[body].tolist(), strict=True):
            text = f"centre of mass of the cab, {axis} of x forward, y left, z up"
            listed.append(ExportedParameter(f"payload.{axis}", "m", text, value, -5.0, 5.0))
    return listed


def payload_body(frozen: Frozen) -> int:
    """Body of the cab in the model, -1 where there is none."""
    return int(mujoco.mj_name2id(frozen.plant.model, mujoco.mjtObj.mjOBJ_BODY, "cab/cab"))


def channels(frozen: Frozen) -> list[ExportedChannel]:
    """All channels of a machine, the pose of a platform last."""
    layout = frozen.session.layout
    listed = [ExportedChannel(c.name, c.unit, c.width or 1, c.first) for c in layout.channels]
    if platform_joint(frozen) >= 0:
        listed.append(ExportedChannel("platform_pose", "m, rad", 6, -1))
    return listed


def platform_joint(frozen: Frozen) -> int:
    """First generalised position of the platform, -1 where there is none."""
    model = frozen.plant.model
    joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, "platform")
    return int(model.jnt_qposadr[joint]) if joint >= 0 else -1


def contents(frozen: Frozen) -> tuple[dict[str, NDArray[np.uint8]], str]:
    """Constant bytes by their C names, and the text of `cmf_machine.h`."""
    listed, table = parameters(frozen), channels(frozen)
    starts = np.array([parameter.start for parameter in listed])
    inertia = frozen.plant.model.body_inertia[payload_body(frozen)].tolist()
    half = frozen.plant.machine.half_stroke
    slots = {path.replace(".", "_"): slot for path, slot in frozen.image.at.items()}
    text = [
        "/* One machine, as exported. */",
        *defines("CMF", _numbers(frozen, listed, table)),
        *defines("AT", slots),
        _array("int cmf_pointers", map(str, frozen.image.pointers)),
        _array("double cmf_starts", map(repr, starts.tolist())),
        _array("double cmf_inertia", map(repr, inertia)),
        _array("cmf_channel_info cmf_channel_table", (_row(c) for c in table)),
        _array("cmf_parameter_info cmf_parameter_table", (_row(p) for p in listed)),
        _array("cmf_failure_info cmf_failure_table", (_failure(kind, half) for kind in KINDS)),
    ]
    for request in Request:
        agree = f"CMF_REQUEST_{request.name} == {request.value}"
        text.append(f"typedef char cmf_{request.name.lower()}_is_that[{agree} ? 1 : -1];")
    return _blocks(frozen, starts), "\n".join([*text, ""])


def _blocks(frozen: Frozen, starts: NDArray[np.float64]) -> dict[str, NDArray[np.uint8]]:
    """Constant bytes by their C names; a machine in memory begins as `cmf_start_data` says."""
    image = frozen.image
    # `head_t` of `cmf.c` up to its parameters: of the state nothing yet, whose state it is.
    head = np.array([0, int(frozen.digest, 16), 0, 0, 0, 0, 0], dtype=np.int64)
    warned = np.zeros(2 * int(mujoco.mjtWarning.mjNWARNING), dtype=np.int32)
    start = (head, starts, frozen.mechanics, frozen.sensors, warned, image.block)
    return {
        "cmf_slots_data": _bytes(image.slots),
        "cmf_arena_data": image.block,
        "cmf_model_data": frozen.model,
        "cmf_start_data": _bytes(*start),
    }


_DEMAND = ("blocks.geometry.upper", "blocks.states.fade")
"""Slots of the controller's source from and to which those are that make demands of host frames."""


def _numbers(
    frozen: Frozen, listed: list[ExportedParameter], table: list[ExportedChannel]
) -> dict[str, object]:
    """Numbers that the C source knows by name: sizes, places and what the machine has."""
    image = frozen.image
    columns = {channel.name: channel.first for channel in table}
    joint = platform_joint(frozen)
    numbers: dict[str, object] = {
        "MUJOCO": mujoco.mj_version(),
        "DIGEST": f"{int(frozen.digest, 16)}u",
        "SLOTS": image.slots.size,
        "ARENA": image.block.size,
        "MODEL": frozen.model.size,
        "MECHANICS": frozen.mechanics.size,
        "SENSORS": frozen.sensors.size,
        "LEGS": frozen.plant.legs,
        "CHAIN": int(frozen.chain),
        "ARRIVALS": ARRIVALS,
        "EVENTS": EVENTS,
        "MOST": MOST_FRAMES,
        "LONGEST": repr(LONGEST),
        "SIGNALS": len(SIGNALS),
        "ENERGIES": len(ENERGIES),
        "ENERGY_COLUMN": columns["energy"],
        "PLATFORM": -1 if joint < 0 else columns["generalised_position"] + joint,
        "BODY": payload_body(frozen),
        "ACCUMULATORS": int(not frozen.parts.dynamics.hydraulics.supply.constant),
        "SUPPLY_OIL": ACCUMULATOR,
        "SUPPLY_GAS": GAS,
        "ATMOSPHERE": repr(ATMOSPHERE),
        "PARAMETERS": len(listed),
    }
    numbers |= {f"P_{_upper(parameter.name)}": place for place, parameter in enumerate(listed)}
    numbers["P_GAIN"] = numbers[f"P_GAIN_{_upper(SIGNALS[0])}"]
    if frozen.chain:
        begin, end = (image.at[f"controller.source.{name}"] for name in _DEMAND)
        numbers["DEMAND_SLOTS"] = end - begin
    return numbers


def defines(prefix: str, numbers: Mapping[str, object]) -> list[str]:
    """Lines of a header that define numbers."""
    return [f"#define {prefix}_{name} {value}" for name, value in numbers.items()]


def _upper(name: str) -> str:
    return name.replace(".", "_").upper()


def _array(name: str, rows: Iterable[str]) -> str:
    return f"static const {name}[] = {{\n  " + ",\n  ".join(rows) + "};"


def _row(values: Iterable[object]) -> str:
    cells = (f'"{value}"' if isinstance(value, str) else repr(value) for value in values)
    return "{" + ", ".join(cells) + "}"


def _failure(kind: str, half_stroke: float) -> str:
    event, unit = default_event(kind, 0.0), ""
    for candidate in ("1", "N", "m", "m^2"):
        with suppress(InputError):
            default_event(kind, 0.0, size=(1.0, candidate))
            unit = candidate
    leg, valve = int(event.leg is not None), int(kind.startswith("valve"))
    return _row([kind, unit, leg, valve, event.magnitude(half_stroke)])


def _bytes(*arrays: NDArray[Any]) -> NDArray[np.uint8]:
    return np.frombuffer(b"".join(array.tobytes() for array in arrays), dtype=np.uint8)
