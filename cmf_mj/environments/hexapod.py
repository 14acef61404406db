"""`cmf_mj/Hexapod-v0`: bring the platform to a pose and keep it there.

With e the target less the pose, in units of 0.1 m and 0.1 rad, and u the action, the reward of a
step is

    r = -(|e|^2 + 0.01 |u|^2) / 32

so that the sum over a run is an integral over time. A run that leaves the machine's bounds ends
with r = -100; a run is truncated after `seconds`.
"""

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.law import Law, load_law
from cmf_mj.core.errors import NoPoseError, check_name
from cmf_mj.environments.environment import FRAMES, Array, MachineEnv, ObservedQuantity
from cmf_mj.facility.session import Session
from cmf_mj.facility.unknowns import Unknowns
from cmf_mj.machine.cab import Cab, load_cab
from cmf_mj.machine.kinematics import legs_to_pose, pose_to_legs
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters import load_hydraulics

ACTIONS = ("pose", "valves", "residual")
"""A pose demand; valve commands; a pose added to the target that the law is given."""

_REACH = np.array([0.3, 0.3, 0.2, 0.15, 0.15, 0.2])
"""Pose of a full action, and the range of targets [m, rad]."""

_RESIDUAL = 0.2
"""Share of it that a residual may add."""


class HexapodEnv(MachineEnv):
    """The motion base under a law, or at its valves."""

    quantities = (
        ObservedQuantity("leg_extension", "m", 6, 1.2),
        ObservedQuantity("leg_velocity", "m/s", 6, 2.0),
        ObservedQuantity("pressure_difference", "MPa", 6, 50.0),
        ObservedQuantity("pose_error", "m, rad", 6, 2.0),
    )

    def __init__(
        self,
        action: str = "pose",
        law: str | Path | Law = "velocity",
        cab: str | Path | Cab = "gfd",
        hydraulics: str = "hardware",
        unknowns: Unknowns | None = None,
        seconds: float = 4.0,
        render_mode: str | None = None,
    ) -> None:
        """Choose what an action is; `unknowns` draw another machine for each run."""
        self.action = check_name("action", action, ACTIONS)
        self._cab, self._oil, self._unknowns = load_cab(cab), load_hydraulics(hydraulics), unknowns
        loaded = None if action == "valves" else load_law(law)
        plant = Hexapod(self._cab, self._oil)
        super().__init__(plant, loaded, 6, seconds, render_mode)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin at rest at neutral; `options` may hold the `target` pose (6,) [m, rad]."""
        super().reset(seed=seed)
        drawn = self.np_random.uniform(-1.0, 1.0, 6) * _REACH
        self.target = self.chosen(options, "target", drawn, self.quantities[3].largest)
        if self._unknowns is not None:
            unknowns = self._unknowns
            values = unknowns.streams(int(self.np_random.integers(2**31)), 0)
            cab = unknowns.apply(values, self._cab)
            self.plant = Hexapod(cab, unknowns.apply(values, self._oil))
        self.begin(np.zeros(6), None)
        self._asked = np.zeros(6)
        return self.observation(), {"target": self.target.copy()}

    def _command(self, action: Array) -> None:
        if self.action == "valves":
            self.table[:] = action
            return
        aim = action * _REACH
        if self.action == "residual":
            aim = self.target + _RESIDUAL * aim
        ramp = np.arange(1, FRAMES + 1)[:, None] / FRAMES
        self.table[:] = pose_to_legs(self._asked + ramp * (aim - self._asked), self.plant.machine)
        self._asked = aim

    def _look(self, session: Session) -> tuple[Array, ...]:
        memory, pressure = session.memory, session.dynamics.state.pressure
        across = 1e-6 * (pressure[:, 0] - pressure[:, 1])
        self._apart = np.zeros(6)
        if np.isfinite(memory.extension).all():
            with suppress(NoPoseError):
                self._apart = self.target - legs_to_pose(memory.extension, self.plant.machine)
        return memory.extension, memory.mean, across, self._apart

    def _judge(self, action: Array) -> tuple[float, bool]:
        error = self._apart / 0.1
        return -float(error @ error + 0.01 * action @ action) * FRAMES / 2048.0, False
