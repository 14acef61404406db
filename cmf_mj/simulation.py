"""Runs: a control law, or a table of valve commands, on a plant -> Record.

`simulate` closes the loop of command, DCL, valves, cylinders, mechanics and sensors; `drive` opens
it at the valves. Both are the one loop of `frame_loop`, whose docstring gives the order.
"""

from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.control import dcl as control
from cmf_mj.control.demand import leg_demand
from cmf_mj.control.law import FRAME, Law, load_law
from cmf_mj.events import Event, make_timeline
from cmf_mj.frame_loop import (
    FINITE,
    LEG_CHANNELS,
    PROOF,
    SOLUTION,
    STROKE,
    VACUUM,
    Controller,
    Layout,
    Machine,
    run,
)
from cmf_mj.plant.cylinder import CAP, ROD
from cmf_mj.plant.faults import no_faults
from cmf_mj.plant.hydraulics import ENERGIES
from cmf_mj.plant.plant import Plant
from cmf_mj.record import Record
from cmf_mj.signals import Command

_VERSIONS = {name: version(name) for name in ("cmf-mj", "mujoco", "numpy", "numba")}

_SUPPLY_CHANNELS = {
    "supply_content": "m^3",
    "return_content": "m^3",
    "accumulator_oil": "m^3",
    "pump_flow": "m^3/s",
    "tank_content": "m^3",
    "isolation": "1",
    "supply_pressure": "Pa",
    "return_pressure": "Pa",
    "accumulator_pressure": "Pa",
}
"""State of the supply, in the order of `plant.supply`."""

_History = tuple[
    NDArray[np.float64], dict[str, NDArray[np.float64]], dict[str, str], dict[str, Any]
]
"""What a `Record` is made of."""


def simulate(
    plant: Plant,
    law: str | Law,
    command: Command | ArrayLike,
    *,
    events: Sequence[Event] = (),
    start: ArrayLike | None = None,
    legs: bool = False,
    record_every: int = 1,
    command_delay: int = 1,
) -> Record:
    """Run a control law on a plant and record all signals.

    The run starts at rest at the first pose of the command, in static equilibrium, with the DCL
    engaged there. Nothing is random: the same arguments give the same bits.

    Args:
        plant: `Hexapod`, `SingleLegs`, or any `Plant`; its mechanical step must divide the
            control frame.
        law: name, TOML file or loaded `Law`.
        command: a `Command`, platform poses (N, 6) at 2048 Hz [m, rad], z down, or with `legs`
            extensions of the actuators (N, n) [m].
        events: failures on the time line.
        start: configuration to start from, as `plant.place` takes it; default the command's first
            pose, with `legs` the model's `qpos0`; `plant.configuration` finds that of extensions.
        legs: whether `command` are extensions.
        record_every: keep one frame in this many.
        command_delay: frames from a DCL frame to its command at the valves.

    Returns:
        Channels of the demand, the legs, the hydraulics, the supply, `energy` passed since the
        start (columns `plant.hydraulics.ENERGIES`), the sensors, `generalised_position` (MuJoCo's
        qpos, to replay), the platform's true pose and `gimbal_error`, the largest distance between
        the halves of a closed gimbal since the row before. `leg_position` is what the sensors
        read, `leg_extension` what is true.

    Raises:
        ValueError: an argument out of range, named.
        FloatingPointError: the state left its physical bounds; leg, time and value are named.
    """
    loaded = load_law(law)
    if legs:
        reference = np.atleast_2d(np.asarray(command, dtype=float))
        if reference.shape[1] != plant.legs:
            raise ValueError(
                f"command: has {reference.shape[1]} columns; allowed: {plant.legs}, one a leg"
            )
        demanded = None
        begin = start
    else:
        demanded = command if isinstance(command, Command) else Command.from_pose(command)
        reference = leg_demand(demanded.pose)
        begin = demanded.pose[0] if start is None else start
    context = {
        "law": loaded.name,
        "law_parameters": loaded.model_dump(),
        "command": dict(demanded.description) if demanded else {"signal": "leg extensions"},
        "seed": demanded.seed if demanded else None,
    }
    time, channels, units, metadata = _run(
        plant, loaded, reference, True, begin, events, record_every, command_delay, context
    )
    if demanded is not None:
        channels = {"demand_pose": demanded.pose[::record_every], **channels}
        units = {"demand_pose": "m, rad", **units}
    return Record(time, channels, units, metadata)


def drive(
    plant: Plant,
    valves: ArrayLike,
    *,
    events: Sequence[Event] = (),
    start: ArrayLike | None = None,
    record_every: int = 1,
    command_delay: int = 0,
) -> Record:
    """Run a plant open loop on given valve commands and record all signals.

    Args:
        plant: any `Plant`.
        valves: valve commands as fractions, -1 to 1, positive extending, (N, n) at 2048 Hz, each
            held over its frame.
        events: failures on the time line.
        start: configuration to start from, as `plant.place` takes it; default neutral.
        record_every: keep one frame in this many.
        command_delay: frames from a row to the valves.

    Returns:
        The channels of `simulate` without those of demand and DCL.

    Raises:
        ValueError: an argument out of range, named.
        FloatingPointError: the state left its physical bounds; leg, time and value are named.
    """
    table = np.atleast_2d(np.asarray(valves, dtype=float))
    if table.ndim != 2 or table.shape[1] != plant.legs:
        raise ValueError(f"valves: has shape {table.shape}; allowed: (N, {plant.legs})")
    if not (np.abs(table) <= 1.0).all():
        row, leg = np.argwhere(~(np.abs(table) <= 1.0))[0]
        raise ValueError(
            f"valves: {table[row, leg]} of leg {leg + 1} in row {row} is not between -1 and 1"
        )
    context = {"law": "", "command": {"signal": "valve commands"}, "seed": None}
    time, channels, units, metadata = _run(
        plant, None, table, False, start, events, record_every, command_delay, context
    )
    for name in ("leg_reference", "compensator_output"):
        del channels[name], units[name]
    return Record(time, channels, units, metadata)


def _run(
    plant: Plant,
    law: Law | None,
    reference: NDArray[np.float64],
    closed: bool,
    start: ArrayLike | None,
    events: Sequence[Event],
    every: int,
    delay: int,
    context: dict[str, Any],
) -> _History:
    for field, value, least in (("record_every", every, 1), ("command_delay", delay, 0)):
        if value < least:
            raise ValueError(f"{field}: {value} frames must be at least {least}")
    step = float(plant.model.opt.timestep)
    steps = round(FRAME / step)
    if steps < 1 or abs(steps * step - FRAME) > 1e-12:
        raise ValueError(f"timestep: {step} s must divide the control frame of {FRAME} s")
    state = plant.start(start)
    mechanics = plant.mechanics()
    dcl = control.make_dcl(law or load_law("original"), plant.legs)
    still = np.zeros(plant.legs)
    begin = control.LegFeedback(
        plant.extensions(), still, still, state.pressure[:, CAP], state.pressure[:, ROD]
    )
    controller = Controller(
        closed,
        dcl,
        control.engaged(dcl, reference[0] if closed else begin.position, begin),
        np.ascontiguousarray(reference),
        delay,
    )
    machine = Machine(
        mechanics,
        plant.hydraulics,
        state,
        no_faults(plant.legs),
        make_timeline(events, plant.legs),
    )
    groups = plant.sensors
    indices = [*groups.values(), np.empty(0, dtype=np.int64)]
    layout = Layout(np.concatenate(indices), plant.gimbal_sensors, steps, every)
    columns = (
        len(LEG_CHANNELS) * plant.legs
        + 1
        + len(_SUPPLY_CHANNELS)
        + len(ENERGIES)
        + mechanics.qpos.size
        + layout.sensors.size
    )
    out = np.empty((-(-reference.shape[0] // every), columns))
    frame, bound, leg = run(machine, controller, layout, out)
    if frame >= 0:
        raise FloatingPointError(_left(plant, machine, context["law"], frame, bound, leg))
    metadata = {
        **plant.describe(),
        **context,
        "events": [event.model_dump(exclude_none=True) for event in events],
        "sample_rate": 1.0 / (FRAME * every),
        "command_delay": delay,
        "versions": dict(_VERSIONS),
    }
    return _history(plant, groups, out, every, metadata)


def _left(plant: Plant, machine: Machine, law: str, frame: int, bound: int, leg: int) -> str:
    """What to say of a state beyond its physical bounds."""
    cap, rod = machine.state.pressure[leg]
    extension = plant.extensions()[leg]
    pressures = f"cap {cap:.4g} Pa, rod {rod:.4g} Pa gauge"
    half, proof = machine.hydraulics.cylinder.half_stroke[leg], machine.hydraulics.proof_pressure
    said = {
        FINITE: f"is not finite: {pressures}, extension {extension:.4g} m",
        VACUUM: f"has a chamber below vacuum ({pressures}); cavitation_gas sets a floor",
        PROOF: f"has a chamber beyond the proof pressure of {proof:.4g} Pa ({pressures})",
        STROKE: f"is at {extension:.4f} m, beyond its stops at +-{half:.4f} m",
        SOLUTION: "and its supply have no solution for this step",
    }[bound]
    with_law = f" with law {law}" if law else ""
    name = plant.actuators[leg]
    return f"{plant.name}{with_law}: {name} {said} at {frame * FRAME:.4f} s"


def _history(
    plant: Plant,
    groups: dict[str, NDArray[np.int64]],
    out: NDArray[np.float64],
    every: int,
    metadata: dict[str, Any],
) -> _History:
    legs = plant.legs
    channels: dict[str, NDArray[np.float64]] = {}
    units: dict[str, str] = {}
    base = 0

    def take(name: str, unit: str, width: int | None) -> None:
        nonlocal base
        size = 1 if width is None else width
        values = out[:, base : base + size]
        channels[name] = values[:, 0] if width is None else values
        units[name] = unit
        base += size

    for name, unit in LEG_CHANNELS.items():
        take(name, unit, legs)
    take("gimbal_error", "m", None)
    for name, unit in _SUPPLY_CHANNELS.items():
        take(name, unit, None)
    take("energy", "J", len(ENERGIES))
    take("generalised_position", "m, rad, 1", plant.model.nq)
    for name, indices in groups.items():
        take(name, "rad/s" if name.endswith("gyro") else "m/s^2", indices.size)
    for name, (values, unit) in plant.derived_channels(channels).items():
        channels[name], units[name] = values, unit
    time = np.arange(out.shape[0], dtype=np.float64) * (every * FRAME)
    return time, channels, units, metadata
