"""Runs of a plant that was built.

`simulate` closes the loop of command, DCL, valves, cylinders, mechanics and sensors; `drive` opens
it at the valves. Both are the one loop of `loop.run`, whose docstring gives the order.
"""

from pathlib import Path
from typing import Any, cast

from numpy.typing import ArrayLike

from cmf_mj.control.law import Law
from cmf_mj.control.protection import ProtectionSettings
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.facility.run import Run
from cmf_mj.facility.signal import LegDemand, ValveCommands
from cmf_mj.plant.plant import Plant
from cmf_mj.record.record import Record
from cmf_mj.signals.signal import Command


def simulate(
    plant: Plant,
    law: str | Law,
    command: Command | ArrayLike,
    *,
    legs: bool = False,
    protection: str | Path | ProtectionSettings | None = None,
    electronics: str | ElectronicsSettings | None = None,
    **options: Any,
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
        electronics: sensors, converters and servo electronics: `noisy`, `inertial` for a plant that
            is no motion base, or `ElectronicsSettings`; default `ideal`, to the bit.
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

    Raises `OutOfBounds` where the state leaves its physical bounds; leg, time and value are named.

    >>> command = cmf_mj.signals.sine("surge", 0.01, frequency=2.0, cycles=1)
    >>> record = cmf_mj.simulate(cmf_mj.Hexapod(), "velocity", command)
    >>> bool(record["gimbal_error"].max() < 1e-5)
    True
    """
    source = LegDemand(cast("ArrayLike", command)) if legs else command
    guarded: dict[str, Any] = {"protection": protection, "electronics": electronics}
    return Run(plant=plant, law=law, source=source, **options, **guarded).record()


def drive(plant: Plant, valves: ArrayLike, **options: Any) -> Record:
    """Run a plant open loop on given valve commands and record all signals.

    Args:
        plant: any `Plant`.
        valves: valve commands as fractions, -1 to 1, positive extending, (N, n), each held
            over its control frame.
        **options: as for `simulate`; `command_delay` is that from a row to the valves, by
            default 0.

    The record has the channels of `simulate` without those of demand and DCL; errors are the same.

    >>> record = cmf_mj.drive(cmf_mj.SingleLegs(), np.full((200, 6), 0.1))
    >>> bool((record["leg_extension"][-1] > 0.0).all())
    True
    """
    run = Run(plant=plant, law=None, source=ValveCommands(valves), **{"command_delay": 0} | options)
    return run.record()
