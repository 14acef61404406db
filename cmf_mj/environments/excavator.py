"""`cmf_mj/Excavator-v0`: bring the cylinders to a place, or through the digging cycle.

An action is the speed of each cylinder's reference as a share of full speed, which the shipped law
follows; the reference changes its speed by at most 3 m/s^2. A place is reached when every cylinder
is within `REACHED`. With dt = 1/32 s, n places reached in the step and p the largest pressure over
the proof pressure, the reward of a step is

    r = 10 n - dt - 10 dt max(p - 0.5, 0)

`task` is `reach`, one random place, or `cycle`: the places of `models/excavator_cycle.csv` in their
order. The run ends when the last is reached.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.law import load_law
from cmf_mj.core.errors import check_name
from cmf_mj.environments.environment import FRAMES, Array, MachineEnv, ObservedQuantity
from cmf_mj.facility.session import Session
from cmf_mj.machine.models import model_path
from cmf_mj.plant.attach import attach_hydraulics

CYLINDERS = ("boom_cylinder", "stick_cylinder", "bucket_cylinder")
REACHED = 0.03
"""Distance of every cylinder within which a place is reached [m]."""

_ACCELERATION = 3.0
"""Of the reference [m/s^2]."""

_FULL = np.array([0.4, 0.5, 0.6])
"""Speed of the reference at a full action [m/s]: that of the cylinders at open valves."""


class ExcavatorEnv(MachineEnv):
    """A 20 t excavator whose law follows the reference that the actions move."""

    quantities = (
        ObservedQuantity("extension", "m", 3, 1.0),
        ObservedQuantity("velocity", "m/s", 3, 2.0),
        ObservedQuantity("reference_less_extension", "m", 3, 1.0),
        ObservedQuantity("place_less_extension", "m", 3, 2.0),
        ObservedQuantity("pressure_over_proof", "1", 3, 2.0),
        ObservedQuantity("places_left", "1", 1, 10.0),
    )

    def __init__(
        self, task: str = "cycle", seconds: float = 30.0, render_mode: str | None = None
    ) -> None:
        """Attach the hydraulics to the model."""
        self.task = check_name("task", task, ("cycle", "reach"))
        plant = attach_hydraulics(
            model_path("excavator.xml"), CYLINDERS, model_path("excavator_hydraulics.toml")
        )
        table = np.genfromtxt(model_path("excavator_cycle.csv"), delimiter=",", names=True)
        self.places = np.column_stack([table[name] for name in CYLINDERS]) - plant.neutral
        """Of the cycle, from half stroke, the start first [m], (5, 3)."""
        law = load_law(model_path("excavator_laws.toml"))
        super().__init__(plant, law, 3, seconds, render_mode)
        self._start = plant.configuration(self.places[0])
        self._span = np.array([cylinder.half_stroke for cylinder in plant.hydraulics.cylinder])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin at rest at the first place; `options` may hold the `places` (N, 3) [m]."""
        super().reset(seed=seed)
        ahead = self.places[1:]
        if self.task == "reach":
            low, high = self.places.min(axis=0), self.places.max(axis=0)
            ahead = self.np_random.uniform(low, high, (1, 3))
        most = self.quantities[3].largest
        self.ahead = list(np.atleast_2d(self.chosen(options, "places", ahead, most)))
        self._reference, self._speed = self.places[0].copy(), np.zeros(3)
        self.pressure = 0.0
        """Largest pressure so far over the proof pressure."""
        self.begin(self._reference, self._start)
        return self.observation(), self._info()

    def _command(self, action: Array) -> None:
        frame = self.plant.machine.frame
        change = np.arange(1, FRAMES + 1)[:, None] * frame * _ACCELERATION
        speed = self._speed + np.clip(action * _FULL - self._speed, -change, change)
        path = self._reference + np.cumsum(speed, axis=0) * frame
        held = np.clip(path, 0.05 - self._span, self._span - 0.05)
        self.table[:] = held
        self._reference = held[-1].copy()
        self._speed = np.where(held[-1] == path[-1], speed[-1], 0.0)

    def _look(self, session: Session) -> tuple[Array, ...]:
        here, place = session.memory.extension, self.ahead[0] if self.ahead else self._reference
        share = session.machine.state.pressure.max(axis=1) / self.plant.hydraulics.proof_pressure
        left = np.array([float(len(self.ahead))])
        return here, session.memory.mean, self._reference - here, place - here, share, left

    def _judge(self, action: Array) -> tuple[float, bool]:
        assert self.session is not None
        here, share = self.session.memory.extension, self._look(self.session)[4].max()
        self.pressure = max(self.pressure, float(share))
        reached = np.abs(self.ahead[0] - here).max() <= REACHED
        if reached:
            self.ahead.pop(0)
        step = FRAMES * self.plant.machine.frame
        return 10.0 * reached - step * (1.0 + 10.0 * max(float(share) - 0.5, 0.0)), not self.ahead

    def _info(self) -> dict[str, Any]:
        session = self.session
        time = 0.0 if session is None else session.frame * self.plant.machine.frame
        return {"time": time, "places_left": len(self.ahead), "pressure_over_proof": self.pressure}
