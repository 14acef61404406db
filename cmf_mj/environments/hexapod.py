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

from cmf_mj.control.law import Law
from cmf_mj.core.errors import NoPoseError, check_name
from cmf_mj.environments.environment import Array, MachineEnv, ObservedQuantity, of_cylinders
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
        """Choose what an action is; `unknowns` draw another machine for each run.

        The options of a reset may hold the `target` pose (6,) [m, rad].
        """
        self.action = check_name("action", action, ACTIONS)
        plant = Hexapod(load_cab(cab), load_hydraulics(hydraulics))
        missing = ObservedQuantity("pose_error", "m, rad", 6, 2.0, HexapodEnv._missing)
        super().__init__(
            *(plant, None if action == "valves" else law),
            reward=HexapodEnv._judge,
            act=None if action == "valves" else HexapodEnv._ramp,
            quantities=(*of_cylinders(plant), missing),
            begin=HexapodEnv._aim,
            unknowns=unknowns,
            seconds=seconds,
            render_mode=render_mode,
        )

    def _aim(self, options: Any) -> None:
        drawn = self.np_random.uniform(-1.0, 1.0, 6) * _REACH
        self.target = self.chosen(options, "target", drawn, self.quantities[3].largest)
        self.info["target"] = self.target.copy()
        self._pose = np.zeros(6)

    def _ramp(self, action: Array) -> Array:
        aim = action * _REACH
        if self.action == "residual":
            aim = self.target + _RESIDUAL * aim
        share = np.arange(1, self.frames + 1)[:, None] / self.frames
        table = pose_to_legs(self._pose + share * (aim - self._pose), self.plant.machine)
        self._pose = aim
        return table

    def _missing(self) -> Array:
        self._apart = np.zeros(6)
        if np.isfinite(self.extension).all():
            with suppress(NoPoseError):
                self._apart = self.target - legs_to_pose(self.extension, self.plant.machine)
        return self._apart

    def _judge(self, action: Array) -> tuple[float, bool]:
        error = self._apart / 0.1
        return -float(error @ error + 0.01 * action @ action) * self.period, False
