"""What the environments share: a session that runs a step at a time, observations, rendering."""

from typing import Any, ClassVar, NamedTuple

import gymnasium as gym
import mujoco
import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.law import Law
from cmf_mj.core.arrays import real
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.units import MOST_FRAMES
from cmf_mj.facility.front import from_table
from cmf_mj.facility.run import Run
from cmf_mj.facility.session import OutOfBounds, Session
from cmf_mj.plant.plant import Plant

Array = NDArray[np.float64]

FRAMES = 64
"""Control frames of a step: 1/32 s."""

LOST = 100.0
"""Taken off the reward of a run that leaves the machine's physical bounds."""

_SIZE = 480, 640
"""Of a picture: rows and columns."""


class ObservedQuantity(NamedTuple):
    """A part of the observation."""

    name: str
    unit: str
    width: int  #: Numbers.
    largest: float  #: Beyond it the observation is held.


def checked(name: str, actions: Any, space: gym.Space[Any]) -> Array:
    """Actions, finite and of the shape of their space."""
    given = real(name, actions)
    if given.shape != space.shape or not np.isfinite(given).all():
        allowed = f"finite numbers of shape {space.shape}"
        raise InputError(f"{name}: {actions} is refused; allowed: {allowed}")
    return given


class MachineEnv(gym.Env[NDArray[np.float32], NDArray[np.float32]]):
    """A machine in steps of 64 control frames.

    A subclass says what an action does (`_command`), what is seen (`_look`) and its reward
    (`_judge`).
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]
        "render_modes": ["rgb_array"],
        "render_fps": 32,
    }
    quantities: tuple[ObservedQuantity, ...]
    """Names, units and order of the observation."""

    def __init__(
        self, plant: Plant, law: Law | None, actions: int, seconds: float, render_mode: str | None
    ) -> None:
        """Make the spaces; `seconds` is the longest run."""
        if render_mode is not None:
            check_name("render_mode", render_mode, self.metadata["render_modes"])
        self.plant, self.law, self.render_mode = plant, law, render_mode
        if not 0.0 < real("seconds", seconds) * plant.machine.rate <= MOST_FRAMES:
            allowed = f"above 0, up to {MOST_FRAMES} frames"
            raise InputError(f"seconds: {seconds} is refused; allowed: {allowed}")
        self.steps = max(round(seconds * plant.machine.rate / FRAMES), 1)
        """Steps after which a run is truncated."""
        largest = np.concatenate([np.full(q.width, q.largest) for q in self.quantities])
        self._high = high = largest.astype(np.float32)
        self.observation_space = gym.spaces.Box(-high, high)
        self.action_space = gym.spaces.Box(-1.0, 1.0, (actions,))
        self.session: Session | None = None
        self._renderer: mujoco.Renderer | None = None

    def begin(self, extension: Array, start: Any) -> None:
        """Start a session at rest at the actuators' extensions, at a configuration of the plant."""
        self.table = np.tile(0.0 * extension if self.law is None else extension, (FRAMES, 1))
        frame = self.plant.machine.frame
        run = Run(
            plant=self.plant,
            law=self.law,
            source=from_table(self.table),
            start=start,
            duration=self.steps * FRAMES * frame,
            record_every=FRAMES,
        )
        self.session = run.session(keep=FRAMES * frame)
        self._done = False

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
        """Run 64 control frames."""
        session = self.session
        if session is None or self._done or session.frame >= session.frames:
            raise gym.error.ResetNeeded("step: reset the environment first")
        acted = np.clip(checked("action", action, self.action_space), -1.0, 1.0)
        self._command(acted)
        left = ""
        try:
            session.run(FRAMES)
        except OutOfBounds as end:
            left = str(end)
        seen = self.observation()
        reward, done = self._judge(acted)
        info = self._info() | ({"left": left} if left else {})
        if left:
            self.session, reward, done = None, -LOST, True
        self._done = done
        return seen, reward, done, session.frame >= session.frames, info

    def observation(self) -> NDArray[np.float32]:
        """What is seen, held within its bounds; what is no number is 0."""
        assert self.session is not None
        seen = np.concatenate(self._look(self.session))
        seen[np.isnan(seen)] = 0.0
        return np.asarray(np.clip(seen, -self._high, self._high), dtype=np.float32)

    def _command(self, action: Array) -> None:
        """Write the table of the next step."""
        raise NotImplementedError

    def _look(self, session: Session) -> tuple[Array, ...]:
        """The parts of the observation."""
        raise NotImplementedError

    def _judge(self, action: Array) -> tuple[float, bool]:
        """Reward of a step, and whether the task is done."""
        raise NotImplementedError

    def _info(self) -> dict[str, Any]:
        return {}

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
