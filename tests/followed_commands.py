"""Records of legs that follow a command and of any feedback, shared by the response tests."""

import control
import numpy as np
from numpy.typing import NDArray
from scipy import signal

from cmf_mj.core.units import RATE
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.record.record import Record
from cmf_mj.signals.signal import Command


def record_of(command: Command, feedback: NDArray[np.float64], every: int = 1) -> Record:
    """A record whose legs follow the command and whose feedback is the pose (N, 6)."""
    poses = {"leg_reference": command.pose[::every], "leg_position": feedback[::every]}
    return Record(
        time=np.arange(command.pose.shape[0])[::every] / RATE,
        channels={name: pose_to_legs(pose) for name, pose in poses.items()},
        units=dict.fromkeys(poses, "m"),
        metadata={"command": dict(command.description), "sample_rate": RATE / every},
    )


def second_order(zeta: float, hertz: float, gain: float = 1.0) -> control.TransferFunction:
    """A second-order system by its damping ratio and natural frequency."""
    omega = 2 * np.pi * hertz
    return control.tf([gain * omega**2], [1.0, 2 * zeta * omega, omega**2])


def answer(
    command: Command, system: control.TransferFunction, inputs: str = "zoh"
) -> NDArray[np.float64]:
    """Pose history (N, 6) of a system in every degree of freedom, its inputs held or joined."""
    sampled = control.sample_system(system, 1 / RATE, method=inputs)
    return np.asarray(signal.lfilter(*sampled.num[0], *sampled.den[0], command.pose, axis=0))
