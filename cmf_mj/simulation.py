"""The one closed loop: command -> DCL -> valves -> cylinders -> mechanics -> sensors -> Record.

One control frame T = 1/2048 s, with m mechanical steps h = T / m in it:

    for each step k:  position stage of MuJoCo at t[k]: extensions l[k]
                      pressures advance from t[k-1] to t[k] between l[k-1] and l[k]
                      (at a frame) sensors, DCL, record
                      cylinder forces of the pressures at t[k] -> force stage: l[k+1]

The order makes the coupling second order at no extra step: the force acts at the instant of its
pressures, and a pressure sees the displacement MuJoCo's leapfrog really made. The command of a
frame reaches the valves one frame later, the time the DCL computes.
"""

from importlib.metadata import version
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj import sensors
from cmf_mj.compiled import compiled
from cmf_mj.control import dcl as control
from cmf_mj.control.demand import leg_demand
from cmf_mj.control.law import FRAME, SIGNALS, Law, load_law
from cmf_mj.plant.hydraulics import CAP, OPENING, ROD, advance, forces
from cmf_mj.plant.native import call
from cmf_mj.plant.plant import Plant
from cmf_mj.record import Record
from cmf_mj.signals import Command

_LEG_CHANNELS = {
    "leg_reference": "m",
    "leg_position": "m",
    "leg_velocity": "m/s",
    "leg_acceleration": "m/s^2",
    "compensator_output": "1",
    "valve_command": "1",
    "valve_opening": "1",
    "cap_pressure": "Pa",
    "rod_pressure": "Pa",
    "leg_force": "N",
}
"""Channels with a leg axis, in the order of the loop's columns."""


_VERSIONS = {name: version(name) for name in ("cmf-mj", "mujoco", "numpy", "numba")}


class _Layout(NamedTuple):
    """What the loop records besides the legs."""

    sensors: NDArray[np.int64]
    """Indices into sensordata."""
    gimbals: NDArray[np.int64]
    """First indices of the gimbal error vectors."""


@compiled
def _loop(  # type: ignore[no-untyped-def]
    mechanics,
    hydraulics,
    dcl,
    dcl_state,
    pressures,
    reference,
    layout,
    step,
    steps,
    every,
    delay,
    out,
):
    """Run all frames; returns the first frame with a state that is not finite, or -1."""
    frames, legs = reference.shape
    extension = mechanics.length - mechanics.neutral
    before = extension.copy()
    mean = np.zeros(legs)
    mean_before = np.zeros(legs)
    load = np.zeros(legs)
    feedback = control.LegFeedback(
        np.zeros(legs), np.zeros(legs), np.zeros(legs), np.zeros(legs), np.zeros(legs)
    )
    signals = np.zeros((legs, len(SIGNALS)))
    output = np.zeros(legs)
    command = np.zeros((delay + 1, legs))
    closure = 0.0
    for frame in range(frames):
        for inner in range(steps):
            call(mechanics.position_stage, mechanics.model, mechanics.data)
            for leg in range(legs):
                before[leg] = extension[leg]
                extension[leg] = mechanics.length[leg] - mechanics.neutral[leg]
                mean_before[leg] = mean[leg]
                mean[leg] = (extension[leg] - before[leg]) / step
            if frame > 0 or inner > 0:
                advance(hydraulics, pressures, command[delay], before, extension, step)
            forces(hydraulics, pressures, load)
            if inner == 0:
                for leg in range(legs):
                    feedback.position[leg] = extension[leg]
                    feedback.velocity[leg] = sensors.velocity(mean[leg], mean_before[leg])
                    feedback.acceleration[leg] = sensors.acceleration(
                        mean[leg], mean_before[leg], step
                    )
                    feedback.cap_pressure[leg] = pressures[leg, CAP]
                    feedback.rod_pressure[leg] = pressures[leg, ROD]
                for age in range(delay, 0, -1):
                    command[age] = command[age - 1]
                control.step(
                    dcl, dcl_state, reference[frame], feedback, signals, output, command[0]
                )
            for i in layout.gimbals:
                x, y, z = mechanics.sensordata[i : i + 3]
                closure = max(closure, np.sqrt(x * x + y * y + z * z))
            if inner == 0 and frame % every == 0:
                row = out[frame // every]
                for leg in range(legs):
                    row[leg] = signals[leg, 0]
                    row[legs + leg] = extension[leg]
                    row[2 * legs + leg] = feedback.velocity[leg]
                    row[3 * legs + leg] = feedback.acceleration[leg]
                    row[4 * legs + leg] = output[leg]
                    row[5 * legs + leg] = command[0, leg]
                    row[6 * legs + leg] = pressures[leg, OPENING]
                    row[7 * legs + leg] = pressures[leg, CAP]
                    row[8 * legs + leg] = pressures[leg, ROD]
                    row[9 * legs + leg] = load[leg]
                base = 10 * legs
                row[base] = closure
                closure = 0.0
                for i in range(mechanics.qpos.shape[0]):
                    row[base + 1 + i] = mechanics.qpos[i]
                base += 1 + mechanics.qpos.shape[0]
                for i in range(layout.sensors.shape[0]):
                    row[base + i] = mechanics.sensordata[layout.sensors[i]]
            if not np.isfinite(np.sum(load)):
                return frame
            mechanics.ctrl[:] = load
            call(mechanics.force_stage, mechanics.model, mechanics.data)
    return -1


def simulate(
    plant: Plant,
    law: str | Law,
    command: Command | ArrayLike,
    *,
    start: ArrayLike | None = None,
    record_every: int = 1,
    command_delay: int = 1,
) -> Record:
    """Run a control law on a plant and record all signals.

    The run starts at rest at the first pose of the command, in static equilibrium, with the DCL
    engaged there. Nothing is random: the same arguments give the same bits.

    Args:
        plant: `Hexapod` or `SingleLegs`; its mechanical step must divide the control frame.
        law: name, TOML file or loaded `Law`.
        command: a `Command`, or platform poses (N, 6) at 2048 Hz [m, rad], z down.
        start: pose to start from (6,); default the command's first.
        record_every: keep one frame in this many.
        command_delay: frames from a DCL frame to its command at the valves.

    Returns:
        Channels of the demand, the legs, the hydraulics, the sensors, `generalised_position`
        (MuJoCo's qpos, to replay), the platform's true pose and `gimbal_error`, the largest
        distance between the halves of a closed gimbal since the row before.

    Raises:
        ValueError: an argument out of range, named.
        FloatingPointError: the state left the finite numbers; time and leg are named.
    """
    loaded = load_law(law)
    demanded = command if isinstance(command, Command) else Command.from_pose(command)
    for field, value in (("record_every", record_every), ("command_delay", command_delay)):
        least = 1 if field == "record_every" else 0
        if value < least:
            raise ValueError(f"{field}: {value} frames must be at least {least}")
    step = float(plant.model.opt.timestep)
    steps = round(FRAME / step)
    if steps < 1 or abs(steps * step - FRAME) > 1e-12:
        raise ValueError(f"timestep: {step} s must divide the control frame of {FRAME} s")

    reference = leg_demand(demanded.pose)
    hydraulic_state = plant.start(demanded.pose[0] if start is None else start)
    mechanics = plant.mechanics()
    dcl = control.make_dcl(loaded, plant.legs)
    begin = control.LegFeedback(
        mechanics.length - mechanics.neutral,
        np.zeros(plant.legs),
        np.zeros(plant.legs),
        hydraulic_state[:, CAP].copy(),
        hydraulic_state[:, ROD].copy(),
    )
    dcl_state = control.engaged(dcl, reference[0], begin)
    groups = plant.sensors
    indices = [*groups.values(), np.empty(0, dtype=np.int64)]
    layout = _Layout(np.concatenate(indices), plant.gimbal_sensors)
    rows = -(-reference.shape[0] // record_every)
    width = len(_LEG_CHANNELS) * plant.legs + 1 + mechanics.qpos.size + layout.sensors.size
    out = np.empty((rows, width))
    failed = _loop(
        mechanics,
        plant.hydraulics,
        dcl,
        dcl_state,
        hydraulic_state,
        reference,
        layout,
        step,
        steps,
        record_every,
        command_delay,
        out,
    )
    if failed >= 0:
        legs = np.flatnonzero(~np.isfinite(hydraulic_state).all(axis=1)) + 1
        raise FloatingPointError(
            f"{plant.name} with law {loaded.name}: state is not finite at "
            f"{failed * FRAME:.4f} s, legs {legs.tolist()}"
        )
    return _to_record(plant, loaded, demanded, groups, out, record_every, command_delay)


def _to_record(
    plant: Plant,
    law: Law,
    command: Command,
    groups: dict[str, NDArray[np.int64]],
    out: NDArray[np.float64],
    every: int,
    delay: int,
) -> Record:
    legs, nq = plant.legs, plant.model.nq
    channels: dict[str, NDArray[np.float64]] = {"demand_pose": command.pose[::every]}
    channel_units = {"demand_pose": "m, rad"}
    for index, (name, unit) in enumerate(_LEG_CHANNELS.items()):
        channels[name] = out[:, index * legs : (index + 1) * legs]
        channel_units[name] = unit
    base = len(_LEG_CHANNELS) * legs
    channels["gimbal_error"] = out[:, base]
    channels["generalised_position"] = out[:, base + 1 : base + 1 + nq]
    channel_units |= {"gimbal_error": "m", "generalised_position": "m, rad, 1"}
    base += 1 + nq
    for name, indices in groups.items():
        channels[name] = out[:, base : base + indices.size]
        channel_units[name] = "rad/s" if name.endswith("gyro") else "m/s^2"
        base += indices.size
    for name, (values, unit) in plant.derived_channels(channels).items():
        channels[name], channel_units[name] = values, unit
    metadata: dict[str, Any] = {
        **plant.describe(),
        "law": law.name,
        "law_parameters": law.model_dump(),
        "command": dict(command.description),
        "seed": command.seed,
        "sample_rate": 1.0 / (FRAME * every),
        "command_delay": delay,
        "versions": dict(_VERSIONS),
    }
    time = np.arange(out.shape[0], dtype=np.float64) * (every * FRAME)
    return Record(time, channels, channel_units, metadata)
