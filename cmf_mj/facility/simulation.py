"""Runs: a control law, or a table of valve commands, on a plant -> Record.

`simulate` closes the loop of command, DCL, valves, cylinders, mechanics and sensors; `drive` opens
it at the valves. Both are the one loop of `loop.run`, whose docstring gives the order.
"""

from pathlib import Path
from typing import Any, Unpack, cast

import numpy as np
from numpy.typing import ArrayLike

from cmf_mj.control.law import Law, load_law
from cmf_mj.control.protection import ProtectionSettings, load_protection
from cmf_mj.core.arrays import real
from cmf_mj.core.errors import InputError
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.facility.options import RunOptions, chosen
from cmf_mj.facility.session import OutOfBounds, Session, Table
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.plant.parameters.loading import fitting
from cmf_mj.plant.plant import Plant
from cmf_mj.record.record import Record
from cmf_mj.signals.signal import Command, commanded

__all__ = ["OutOfBounds", "drive", "simulate"]


def simulate(
    plant: Plant,
    law: str | Law,
    command: Command | ArrayLike,
    *,
    legs: bool = False,
    protection: str | Path | ProtectionSettings | None = None,
    electronics: ElectronicsSettings | None = None,
    **options: Unpack[RunOptions],
) -> Record:
    """Run a control law on a plant and record all signals.

    The run starts at rest at the first pose of the command, in static equilibrium, with the DCL
    engaged there. The same arguments give the same bits on one kind of processor.

    Args:
        plant: `Hexapod`, `SingleLegs`, or any `Plant`; its mechanical step must divide the
            control frame.
        law: name, TOML file or loaded `Law`.
        command: a `Command`, platform poses (N, 6) at the control rate [m, rad], z down, or with
            `legs` extensions of the actuators (N, n) [m].
        legs: whether `command` are extensions.
        protection: conditions that make an emergency stop, `default` or a TOML file; the metadata
            tell the `fault` and its time. Default none.
        electronics: sensors, converters and servo electronics; default ideal, to the bit.
        **options: `start`, by default the command's first pose, with `legs` the model's `qpos0`
            (`plant.configuration` gives that of extensions); `events` on the time line;
            `record_every`, keep one frame in this many; `command_delay`, frames from a DCL frame
            to its command at the valves, by default 1.

    Returns:
        Channels of the demand, the legs, the hydraulics, the supply, `energy` passed since the
        start (columns `plant.hydraulics.ENERGIES`), the sensors, `generalised_position` (MuJoCo's
        qpos, to replay), the platform's true pose and `gimbal_error`, the largest distance between
        the halves of a closed gimbal since the row before. `leg_position` is what the sensors
        read, `leg_extension` what is true.

    Raises:
        InputError: an argument out of range, named.
        OutOfBounds: the state left its physical bounds; leg, time and value are named.

    >>> command = cmf_mj.signals.sine("surge", 0.01, frequency=2.0, cycles=1)
    >>> record = cmf_mj.simulate(cmf_mj.Hexapod(), "velocity", command)
    >>> bool(record["gimbal_error"].max() < 1e-5)
    True
    """
    settings, loaded = chosen(plant, options), load_law(law)
    if legs:
        reference = np.atleast_2d(real("command", cast("ArrayLike", command)))
        if reference.shape[1] != plant.legs:
            raise InputError(
                f"command: has {reference.shape[1]} columns; allowed: {plant.legs}, one a leg"
            )
        table, demanded = Table(reference), None
    else:
        demanded = commanded(command, plant.machine.rate)
        table = Table(pose_to_legs(demanded.pose, plant.machine), demanded.pose)
        if settings.start is None:
            settings = settings._replace(start=demanded.pose[0])
    context: dict[str, Any] = {
        "command": demanded.description if demanded else {"signal": "leg extensions"},
        "seed": demanded.seed if demanded else None,
    }
    guard = None if protection is None else load_protection(protection, fitting(plant.machine))
    settings = settings._replace(protection=guard, electronics=electronics)
    session = Session(plant, loaded, table, settings)
    session.run()
    time, channels, units = session.history()
    return Record(time, channels, units, session.describe() | context)


def drive(plant: Plant, valves: ArrayLike, **options: Unpack[RunOptions]) -> Record:
    """Run a plant open loop on given valve commands and record all signals.

    Args:
        plant: any `Plant`.
        valves: valve commands as fractions, -1 to 1, positive extending, (N, n), each held
            over its control frame.
        **options: as for `simulate`; `command_delay` is that from a row to the valves, by
            default 0.

    Returns:
        The channels of `simulate` without those of demand and DCL.

    Raises:
        InputError: an argument out of range, named.
        OutOfBounds: the state left its physical bounds; leg, time and value are named.

    >>> record = cmf_mj.drive(cmf_mj.SingleLegs(), np.full((200, 6), 0.1))
    >>> bool((record["leg_extension"][-1] > 0.0).all())
    True
    """
    settings = chosen(plant, {"command_delay": 0, **options})
    table = np.atleast_2d(real("valves", valves))
    if table.ndim != 2 or table.shape[1] != plant.legs:
        raise InputError(f"valves: has shape {table.shape}; allowed: (N, {plant.legs})")
    if not (np.abs(table) <= 1.0).all():
        row, leg = np.argwhere(~(np.abs(table) <= 1.0))[0]
        raise InputError(
            f"valves: {table[row, leg]} of leg {leg + 1} in row {row} is not between -1 and 1"
        )
    session = Session(plant, None, Table(table), settings)
    session.run()
    time, channels, units = session.history()
    context = {"command": {"signal": "valve commands"}, "seed": None}
    return Record(time, channels, units, session.describe() | context)
