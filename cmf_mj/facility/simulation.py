"""Runs: a control law, or a table of valve commands, on a plant -> Record.

`simulate` closes the loop of command, DCL, valves, cylinders, mechanics and sensors; `drive` opens
it at the valves. Both are the one loop of `loop.run`, whose docstring gives the order.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cmf_mj.control.demand import leg_demand
from cmf_mj.control.law import Law, load_law
from cmf_mj.control.protection import ProtectionSettings, load_protection
from cmf_mj.core.errors import InputError
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.facility.session import OutOfBounds, Session
from cmf_mj.plant.events import Event
from cmf_mj.plant.plant import Plant
from cmf_mj.record.record import Record
from cmf_mj.signals.single import Command

__all__ = ["OutOfBounds", "drive", "simulate"]


def simulate(
    plant: Plant,
    law: str | Law,
    command: Command | ArrayLike,
    *,
    events: Sequence[Event] = (),
    start: ArrayLike | None = None,
    legs: bool = False,
    protection: str | Path | ProtectionSettings | None = None,
    electronics: ElectronicsSettings | None = None,
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
        protection: conditions that make an emergency stop, `default` or a TOML file; the metadata
            tell the `fault` and its time. Default none.
        electronics: sensors, converters and servo electronics; default ideal, to the bit.
        record_every: keep one frame in this many.
        command_delay: frames from a DCL frame to its command at the valves.

    Returns:
        Channels of the demand, the legs, the hydraulics, the supply, `energy` passed since the
        start (columns `plant.hydraulics.ENERGIES`), the sensors, `generalised_position` (MuJoCo's
        qpos, to replay), the platform's true pose and `gimbal_error`, the largest distance between
        the halves of a closed gimbal since the row before. `leg_position` is what the sensors
        read, `leg_extension` what is true.

    Raises:
        InputError: an argument out of range, named.
        OutOfBounds: the state left its physical bounds; leg, time and value are named.
    """
    loaded = load_law(law)
    if legs:
        reference = np.atleast_2d(np.asarray(command, dtype=float))
        if reference.shape[1] != plant.legs:
            raise InputError(
                f"command: has {reference.shape[1]} columns; allowed: {plant.legs}, one a leg"
            )
        demanded = None
        begin = start
    else:
        demanded = command if isinstance(command, Command) else Command.from_pose(command)
        reference = leg_demand(demanded.pose)
        begin = demanded.pose[0] if start is None else start
    context: dict[str, Any] = {
        "command": dict(demanded.description) if demanded else {"signal": "leg extensions"},
        "seed": demanded.seed if demanded else None,
    }
    session = Session(
        plant,
        loaded,
        reference,
        start=begin,
        events=events,
        protection=None if protection is None else load_protection(protection),
        electronics=electronics,
        record_every=record_every,
        command_delay=command_delay,
    )
    session.run()
    time, channels, units = session.history()
    if demanded is not None:
        channels = {"demand_pose": demanded.pose[::record_every], **channels}
        units = {"demand_pose": "m, rad", **units}
    return Record(time, channels, units, session.describe() | context)


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
        InputError: an argument out of range, named.
        OutOfBounds: the state left its physical bounds; leg, time and value are named.
    """
    table = np.atleast_2d(np.asarray(valves, dtype=float))
    if table.ndim != 2 or table.shape[1] != plant.legs:
        raise InputError(f"valves: has shape {table.shape}; allowed: (N, {plant.legs})")
    if not (np.abs(table) <= 1.0).all():
        row, leg = np.argwhere(~(np.abs(table) <= 1.0))[0]
        raise InputError(
            f"valves: {table[row, leg]} of leg {leg + 1} in row {row} is not between -1 and 1"
        )
    session = Session(
        plant,
        None,
        table,
        start=start,
        events=events,
        record_every=record_every,
        command_delay=command_delay,
    )
    session.run()
    time, channels, units = session.history()
    for name in ("leg_reference", "compensator_output"):
        del channels[name], units[name]
    context = {"command": {"signal": "valve commands"}, "seed": None}
    return Record(time, channels, units, session.describe() | context)
