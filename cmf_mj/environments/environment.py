"""Any plant as a Gymnasium environment: a session that runs a step of control frames at a time.

The arguments choose the action, the observation, the reward, the task of a run and the unknown
numbers of its machine. By default an action is the valve commands, or with a law the extensions
demanded, and the observation is `of_cylinders`.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from copy import deepcopy
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import gymnasium as gym
import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.control.law import Law, load_law
from cmf_mj.core.arrays import real, shaped, whole
from cmf_mj.core.errors import InputError, NoPoseError, check_name
from cmf_mj.core.units import MOST_FRAMES
from cmf_mj.facility.front import from_table
from cmf_mj.facility.run import Run
from cmf_mj.facility.session import OutOfBounds, Session
from cmf_mj.facility.unknowns import Unknowns
from cmf_mj.machine.cab import Cab, load_cab
from cmf_mj.machine.kinematics import legs_to_pose, pose_to_legs
from cmf_mj.plant.cylinder import CAP, ROD
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters import load_hydraulics
from cmf_mj.plant.plant import Plant

Array = NDArray[np.float64]

FRAMES = 64  #: Control frames of a step, by default: 1/32 s at 2048 Hz.
_PENALTY = 100.0  #: The reward is less by it where a run leaves the machine's physical bounds.
_PICTURE_SIZE = 480, 640  #: Rows and columns.


class ObservedQuantity(NamedTuple):
    """A part of the observation."""

    name: str
    unit: str
    width: int  #: Numbers.
    largest: float  #: Bound of the observation.
    of: Callable[[Any], ArrayLike]  #: The numbers, of the environment.


def of_cylinders(plant: Plant) -> tuple[ObservedQuantity, ...]:
    """Extension, velocity and pressure difference of each cylinder."""
    count, reach = plant.legs, 1.25 * float(plant.hydraulics.cylinder.half_stroke.max())

    def pressure_difference(env: MachineEnv) -> Array:
        pressure = env.running.dynamics.state.pressure
        return 1e-6 * (pressure[:, CAP] - pressure[:, ROD])

    return (
        ObservedQuantity("leg_extension", "m", count, reach, lambda env: env.extension),
        ObservedQuantity(
            "leg_velocity", "m/s", count, 2.0, lambda env: env.running.memory.mean_velocity
        ),
        ObservedQuantity("pressure_difference", "MPa", count, 50.0, pressure_difference),
    )


class MachineEnv(gym.Env[NDArray[np.float32], NDArray[np.float32]]):
    """A plant in steps of some control frames.

    >>> from cmf_mj.environments import MachineEnv
    >>> def closeness(env, action):  # of extensions to the middle; the task never ends
    ...     return -float(np.abs(env.extension).sum()), False
    >>> env = MachineEnv(cmf_mj.SingleLegs(), reward=closeness, frames=128, seconds=2.0)
    >>> observation, info = env.reset(seed=0)
    >>> env.step(0.1 * np.ones(6))[0].shape
    (18,)
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"]}  # type: ignore[misc]

    def __init__(
        self,
        plant: Plant,
        law: str | Path | Law | None = None,
        *,
        reward: Callable[[Any, Array], tuple[float, bool]],
        act: Callable[[Any, Array], ArrayLike] | None = None,
        actions: int | None = None,
        quantities: Sequence[ObservedQuantity] | None = None,
        begin: Callable[[Any, Any], None] | None = None,
        start: ArrayLike | None = None,
        unknowns: Unknowns | None = None,
        frames: int = FRAMES,
        seconds: float = 4.0,
        render_mode: str | None = None,
    ) -> None:
        """Make the spaces; the functions are called with the environment.

        Args:
            plant: any; `unknowns` draw another from it for each run.
            law: what the extensions of the table are demanded of; None for valve commands.
            reward: of the step that an action made, and whether the task is done.
            act: the table of a step, (frames, n), of actions from -1 to 1; by default valve
                commands held, or extensions in half strokes, approached in a straight line.
            actions: numbers of an action, by default one a cylinder.
            quantities: what is seen, in this order; default `of_cylinders`.
            begin: called by each reset with its options, to draw what the run is about by
                `env.np_random`; what it puts in `env.info` is handed out.
            start: configuration that runs begin in, at rest; default the model's own.
            unknowns: what differs from run to run.
            frames: control frames of a step.
            seconds: longest run, then truncated [s].
            render_mode: `rgb_array`, or None.
        """
        if render_mode is not None:
            check_name("render_mode", render_mode, self.metadata["render_modes"])
        self.plant, self._nominal, self._unknowns = plant, plant, unknowns
        self.law = self._nominal_law = None if law is None else load_law(law, plant.machine)
        self.render_mode, self._reward, self._begin = render_mode, reward, begin
        self._act = MachineEnv._table if act is None else act
        self.frames, self._start = whole("frames", frames, 1, MOST_FRAMES), start
        if not 0.0 < real("seconds", seconds) * plant.machine.rate <= MOST_FRAMES:
            allowed = f"above 0, up to {MOST_FRAMES} frames"
            raise InputError(f"seconds: {seconds} is refused; allowed: {allowed}")
        self.steps = max(round(seconds * plant.machine.rate / self.frames), 1)
        """Steps after which a run is truncated."""
        self.period = self.frames * plant.machine.frame  #: Length of a step [s].
        self.metadata = {**self.metadata, "render_fps": max(round(1.0 / self.period), 1)}  # type: ignore[misc]
        self.quantities = tuple(of_cylinders(plant) if quantities is None else quantities)
        """Names, units and order of the observation."""
        largest = np.concatenate([np.full(q.width, q.largest) for q in self.quantities])
        self._high = high = largest.astype(np.float32)
        self.observation_space = gym.spaces.Box(-high, high)
        self._actions = plant.legs if actions is None else actions
        self.action_space = gym.spaces.Box(-1.0, 1.0, (self._actions,))
        self.session: Session | None = None
        self.info: dict[str, Any] = {}  #: What a reset and a step return with the observation.
        self._renderer: mujoco.Renderer | None = None

    @property
    def running(self) -> Session:
        """The session; a step before the first reset is refused."""
        if self.session is None:
            raise gym.error.ResetNeeded("step: reset the environment first")
        return self.session

    @property
    def extension(self) -> Array:
        """True extensions [m], (n,)."""
        return self.running.memory.extension

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin at rest, on a machine drawn from the unknowns."""
        super().reset(seed=seed)
        self.info = {}
        if self._begin is not None:
            self._begin(self, options)
        elif options:
            raise InputError(f"options: {options!r} is refused; allowed: none")
        if self._unknowns is not None:
            unknowns = self._unknowns.on(self._nominal)
            values = unknowns.streams(int(self.np_random.integers(2**31)), 0)
            self.plant = unknowns.apply(values, self._nominal)
            if self._nominal_law is not None:
                self.law = unknowns.apply(values, self._nominal_law)
        self.plant.start(self._start)
        self._demand = self.plant.extensions()
        row = 0.0 * self._demand if self.law is None else self._demand
        self.table = np.tile(row, (self.frames, 1))
        run = Run(
            plant=self.plant,
            law=self.law,
            source=from_table(self.table),
            start=self._start,
            duration=self.steps * self.period,
            record_every=self.frames,
        )
        self.session = run.session(kept_seconds=self.period)
        self._is_done = False
        return self.observation(), deepcopy(self.info)

    @staticmethod
    def option(options: Any, name: str, default: Array, largest: float) -> Array:
        """The only option of a reset, rows of as many numbers as the default has."""
        table = {} if options is None else options
        if not isinstance(table, dict) or table.keys() - {name}:
            raise InputError(f"options: {options!r} is refused; allowed: {{{name!r}: numbers}}")
        values = real(name, table.get(name, default))
        is_wide = values.size and values.shape[-1:] == default.shape[-1:]
        if not (is_wide and values.ndim <= default.ndim and (np.abs(values) <= largest).all()):
            allowed = f"numbers of shape {default.shape}, of size {largest:g} at most"
            raise InputError(f"{name}: {values.tolist()} is refused; allowed: {allowed}")
        return values.copy()

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Run the control frames of a step."""
        session = self.running
        if self._is_done or session.frame >= session.frames:
            raise gym.error.ResetNeeded("step: reset the environment first")
        bounded_action = np.clip(shaped("action", action, self._actions), -1.0, 1.0)
        self.table[:] = self._act(self, bounded_action)
        end: dict[str, Any] = {}
        try:
            session.run(self.frames)
        except OutOfBounds as error:
            end["left"] = str(error)
        observation = self.observation()
        reward, self._is_done = self._reward(self, bounded_action)
        if end:
            self.session, reward, self._is_done = None, -_PENALTY, True
        info = deepcopy(self.info) | end
        return observation, reward, self._is_done, session.frame >= session.frames, info

    def _table(self, action: Array) -> Array:
        """Valve commands, or demanded extensions, of an action: `act` by default."""
        if self.law is None:
            return action
        old_demand, self._demand = self._demand, action * self.plant.hydraulics.cylinder.half_stroke
        return self._line(old_demand, self._demand)

    def _line(self, begin: Array, end: Array) -> Array:
        """A table that goes from one row, which it has not, to another in a straight line."""
        share = np.arange(1, self.frames + 1)[:, None] / self.frames
        return np.asarray(begin + share * (end - begin))

    def observation(self) -> NDArray[np.float32]:
        """The quantities within their bounds; what is no number is 0."""
        values = np.concatenate([np.atleast_1d(quantity.of(self)) for quantity in self.quantities])
        values[np.isnan(values)] = 0.0
        return np.asarray(np.clip(values, -self._high, self._high), dtype=np.float32)

    def render(self) -> Any:
        """A picture of the machine, (480, 640, 3)."""
        if self.render_mode is None or self.session is None:
            return None
        model = self.plant.drawn_model
        if self._renderer is None:
            self._renderer = mujoco.Renderer(model, *_PICTURE_SIZE)
            self._picture_data = mujoco.MjData(model)
        self._picture_data.qpos[:] = self.plant.data.qpos
        mujoco.mj_forward(model, self._picture_data)
        self._renderer.update_scene(self._picture_data)
        return self._renderer.render()

    def close(self) -> None:
        """Free the renderer."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


ACTIONS = ("pose", "valves", "residual")
"""A pose demand; valve commands; a pose added to the target that the law is given."""

_REACH = np.array([0.3, 0.3, 0.2, 0.15, 0.15, 0.2])
"""Pose of a full action, and the range of targets [m, rad]."""
_RESIDUAL = 0.2  #: Share of it that a residual may add.
_LARGEST_ERROR = 2.0  #: Bound of the observed pose error and of targets [m, rad].


class HexapodEnv(MachineEnv):
    """`cmf_mj/Hexapod-v0`: bring the platform to a pose and keep it there, by a law or valves.

    With e the target less the pose, in units of 0.1 m and 0.1 rad, and u the action, the reward of
    a step is r = -(|e|^2 + 0.01 |u|^2) / 32, so that the sum over a run is an integral over time.
    """

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
        error = ObservedQuantity(
            "pose_error", "m, rad", 6, _LARGEST_ERROR, HexapodEnv._measure_error
        )
        super().__init__(
            plant,
            None if action == "valves" else law,
            reward=HexapodEnv._error_reward,
            act=None if action == "valves" else HexapodEnv._leg_table,
            quantities=(*of_cylinders(plant), error),
            begin=HexapodEnv._choose_target,
            unknowns=unknowns,
            seconds=seconds,
            render_mode=render_mode,
        )

    def _choose_target(self, options: Any) -> None:
        random_target = self.np_random.uniform(-1.0, 1.0, 6) * _REACH
        self.target = self.option(options, "target", random_target, _LARGEST_ERROR)
        self.info["target"] = self.target.copy()
        self._pose = np.zeros(6)

    def _leg_table(self, action: Array) -> Array:
        pose = action * _REACH
        if self.action == "residual":
            pose = self.target + _RESIDUAL * pose
        table = pose_to_legs(self._line(self._pose, pose), self.plant.machine)
        self._pose = pose
        return table

    def _measure_error(self) -> Array:
        """The target less the pose; 0 where the legs have none."""
        self._pose_error = np.zeros(6)
        if np.isfinite(self.extension).all():
            with suppress(NoPoseError):
                self._pose_error = self.target - legs_to_pose(self.extension, self.plant.machine)
        return self._pose_error

    def _error_reward(self, action: Array) -> tuple[float, bool]:
        error = self._pose_error / 0.1
        return -float(error @ error + 0.01 * action @ action) * self.period, False
