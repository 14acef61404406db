"""Any plant as a Gymnasium environment: a session that runs a step of control frames at a time.

What an action does, what is seen, the reward, what a run is about and how machines differ are
arguments; without them an action is the valve commands, or with a law the extensions demanded, and
the cylinders are seen.
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

LOST = 100.0  #: Taken off the reward of a run that leaves the machine's physical bounds.

_SIZE = 480, 640  #: Of a picture: rows and columns.


class ObservedQuantity(NamedTuple):
    """A part of the observation."""

    name: str
    unit: str
    width: int  #: Numbers.
    largest: float  #: Beyond it the observation is held.
    of: Callable[[Any], ArrayLike]  #: The numbers, of the environment.


def of_cylinders(plant: Plant) -> tuple[ObservedQuantity, ...]:
    """Extension, velocity and pressure difference of each cylinder."""
    count, reach = plant.legs, 1.25 * float(plant.hydraulics.cylinder.half_stroke.max())

    def across(env: MachineEnv) -> Array:
        pressure = env.running.dynamics.state.pressure
        return 1e-6 * (pressure[:, CAP] - pressure[:, ROD])

    return (
        ObservedQuantity("leg_extension", "m", count, reach, lambda env: env.extension),
        ObservedQuantity(
            "leg_velocity", "m/s", count, 2.0, lambda env: env.running.memory.mean_velocity
        ),
        ObservedQuantity("pressure_difference", "MPa", count, 50.0, across),
    )


class MachineEnv(gym.Env[NDArray[np.float32], NDArray[np.float32]]):
    """A plant in steps of some control frames.

    >>> from cmf_mj.environments import MachineEnv
    >>> def still(env, action):  # extensions near the middle; the task never ends
    ...     return -float(np.abs(env.extension).sum()), False
    >>> env = MachineEnv(cmf_mj.SingleLegs(), reward=still, frames=128, seconds=2.0)
    >>> seen, info = env.reset(seed=0)
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
        self.render_mode, self._reward, self._act, self._begin = render_mode, reward, act, begin
        self.frames, self._start = whole("frames", frames, 1, MOST_FRAMES), start
        if not 0.0 < real("seconds", seconds) * plant.machine.rate <= MOST_FRAMES:
            allowed = f"above 0, up to {MOST_FRAMES} frames"
            raise InputError(f"seconds: {seconds} is refused; allowed: {allowed}")
        self.steps = max(round(seconds * plant.machine.rate / self.frames), 1)
        """Steps after which a run is truncated."""
        self.period = self.frames * plant.machine.frame
        """Length of a step [s]."""
        self.metadata = {**self.metadata, "render_fps": max(round(1.0 / self.period), 1)}  # type: ignore[misc]
        self.quantities = tuple(of_cylinders(plant) if quantities is None else quantities)
        """Names, units and order of the observation."""
        largest = np.concatenate([np.full(q.width, q.largest) for q in self.quantities])
        self._high = high = largest.astype(np.float32)
        self.observation_space = gym.spaces.Box(-high, high)
        self._actions = plant.legs if actions is None else actions
        self.action_space = gym.spaces.Box(-1.0, 1.0, (self._actions,))
        self.session: Session | None = None
        self.info: dict[str, Any] = {}
        """What a reset and a step hand out beside the observation."""
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
            own = self._unknowns.on(self._nominal)
            values = own.streams(int(self.np_random.integers(2**31)), 0)
            self.plant = own.apply(values, self._nominal)
            if self._nominal_law is not None:
                self.law = own.apply(values, self._nominal_law)
        self.plant.start(self._start)
        self._asked = self.plant.extensions()
        table = 0.0 * self._asked if self.law is None else self._asked
        self.table = np.tile(table, (self.frames, 1))
        run = Run(
            plant=self.plant,
            law=self.law,
            source=from_table(self.table),
            start=self._start,
            duration=self.steps * self.period,
            record_every=self.frames,
        )
        self.session = run.session(kept_seconds=self.period)
        self._done = False
        return self.observation(), deepcopy(self.info)

    @staticmethod
    def chosen(options: Any, name: str, drawn: Array, most: float) -> Array:
        """What the options of a reset have under a name, rows of as many numbers as are drawn."""
        given = {} if options is None else options
        if not isinstance(given, dict) or given.keys() - {name}:
            raise InputError(f"options: {options!r} is refused; allowed: {{{name!r}: numbers}}")
        values = real(name, given.get(name, drawn))
        fits = values.size and values.ndim <= drawn.ndim and values.shape[-1:] == drawn.shape[-1:]
        if not (fits and (np.abs(values) <= most).all()):
            allowed = f"numbers of shape {drawn.shape}, of size {most:g} at most"
            raise InputError(f"{name}: {values.tolist()} is refused; allowed: {allowed}")
        return values.copy()

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Run the control frames of a step."""
        session = self.running
        if self._done or session.frame >= session.frames:
            raise gym.error.ResetNeeded("step: reset the environment first")
        acted = np.clip(shaped("action", action, self._actions), -1.0, 1.0)
        self.table[:] = self._held(acted) if self._act is None else self._act(self, acted)
        left: dict[str, Any] = {}
        try:
            session.run(self.frames)
        except OutOfBounds as end:
            left["left"] = str(end)
        seen = self.observation()
        reward, done = self._reward(self, acted)
        if left:
            self.session, reward, done = None, -LOST, True
        self._done = done
        return seen, reward, done, session.frame >= session.frames, deepcopy(self.info) | left

    def _held(self, action: Array) -> Array:
        """The table without `act`."""
        if self.law is None:
            return action
        before, self._asked = self._asked, action * self.plant.hydraulics.cylinder.half_stroke
        share = np.arange(1, self.frames + 1)[:, None] / self.frames
        return np.asarray(before + share * (self._asked - before))

    def observation(self) -> NDArray[np.float32]:
        """What is seen, held within its bounds; what is no number is 0."""
        seen = np.concatenate([np.atleast_1d(quantity.of(self)) for quantity in self.quantities])
        seen[np.isnan(seen)] = 0.0
        return np.asarray(np.clip(seen, -self._high, self._high), dtype=np.float32)

    def render(self) -> Any:
        """A picture of the machine, (480, 640, 3)."""
        if self.render_mode is None or self.session is None:
            return None
        model = self.plant.drawn_model
        if self._renderer is None:
            self._renderer, self._drawn = mujoco.Renderer(model, *_SIZE), mujoco.MjData(model)
        self._drawn.qpos[:] = self.plant.data.qpos
        mujoco.mj_forward(model, self._drawn)
        self._renderer.update_scene(self._drawn)
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
