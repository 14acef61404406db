"""A live run in MuJoCo's viewer: what happens between two pictures, with or without a window.

The mouse pulls a body as in any viewer; the force goes to the loop as a push, so that the run can
be saved as a scenario and done again. Keys: space stops time, + and - change the pace, S saves.
"""

import time
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from cmf_mj.core.errors import InputError
from cmf_mj.core.rates import RATE
from cmf_mj.facility.scenario.run import ScenarioRun
from cmf_mj.facility.scenario.settings import Change, Push
from cmf_mj.show.film.stage import has_display

SPEEDS = (0.05, 0.1, 0.25, 0.5, 1.0)
"""Times real speed that + and - go through."""

_KEYPAD_MINUS, _KEYPAD_PLUS = 333, 334
_LONGEST = 0.1
"""Time run between two pictures at most [s]: a machine too slow for real time shows slow motion."""

NO_DISPLAY = (
    "view: no display: DISPLAY and WAYLAND_DISPLAY are not set. `cmf video` needs none: it renders "
    "off-screen with MUJOCO_GL=egl (libegl1, libgl1-mesa-dri) or MUJOCO_GL=osmesa (libosmesa6). "
    "For a window without a screen use a virtual one: `xvfb-run cmf view` (package xvfb)."
)


class LiveView:
    """A run between two pictures: pace, pause and pulls."""

    def __init__(self, run: ScenarioRun, speed: float = 1.0) -> None:
        """Show a run, which is advanced from here, at a multiple of real speed."""
        if not (np.isfinite(speed) and speed > 0.0):
            raise InputError(f"speed: {speed} must be greater than 0")
        self.run, self.speed, self.paused = run, speed, False
        self.wants_saving = False
        self.model = run.plant.drawn_model
        self.drawn = mujoco.MjData(self.model)
        """A copy of the MuJoCo state for the viewer: what it does there does not act on the run."""
        self._owed = 0.0
        self._pulled = ""
        self._copy()

    def key(self, code: int) -> None:
        """Take a key of the viewer, by its GLFW number."""
        if code == ord(" "):
            self.paused = not self.paused
        elif code == ord("S"):
            self.wants_saving = True
        elif code in (ord("-"), _KEYPAD_MINUS):
            self.speed = max((s for s in SPEEDS if s < self.speed), default=SPEEDS[0])
        elif code in (ord("="), _KEYPAD_PLUS):
            self.speed = min((s for s in SPEEDS if s > self.speed), default=SPEEDS[-1])

    def pull(self, perturb: mujoco.MjvPerturb) -> None:
        """Hand the mouse's force over to the run."""
        self.drawn.xfrc_applied[:] = 0.0
        mujoco.mjv_applyPerturbForce(self.model, self.drawn, perturb)
        wrench = self.drawn.xfrc_applied
        pulled = int(np.abs(wrench).sum(axis=1).argmax())
        name = self.model.body(pulled).name if wrench[pulled].any() else ""
        if self._pulled and self._pulled != name:
            self.run.apply(Change(push=Push(body=self._pulled)))
        if name:
            x, y, z, a, b, c = wrench[pulled].tolist()
            self.run.apply(Change(push=Push(body=name, force=(x, y, z), torque=(a, b, c))))
        self._pulled = name

    def step(self, elapsed: float) -> None:
        """Run on by what has passed since the last picture [s], at the pace chosen."""
        if not self.paused:
            self._owed += min(elapsed, _LONGEST) * self.speed * RATE
            frames = int(self._owed)
            self._owed -= frames
            self.run.advance(frames)
        self._copy()

    def text(self) -> str:
        """Law, time, pace and state for the corner of the picture."""
        live = self.run.latest()
        paused = " paused" if self.paused else ""
        state = f"\n{live.state}" if live.state else ""
        return f"{live.law}\n{live.time:.2f} s\n{self.speed:g} x{paused}{state}"

    def _copy(self) -> None:
        source = self.run.plant.data
        self.drawn.time = self.run.frame / RATE
        self.drawn.qpos[:], self.drawn.qvel[:] = source.qpos, source.qvel
        mujoco.mj_forward(self.model, self.drawn)


def show(
    view: LiveView,
    *,
    seconds: float | None = None,
    save: Callable[[ScenarioRun], None] | None = None,
    launch: Callable[..., Any] | None = None,
) -> None:
    """Open a window on a run until it is closed, the run is over or `seconds` of wall time are.

    `save` is called when S is pressed; `launch` opens the window, by default MuJoCo's
    `viewer.launch_passive`. Raises `InputError` without a display, or without OpenGL on it.
    """
    if launch is None:
        if not has_display():
            raise InputError(NO_DISPLAY)
        import mujoco.viewer

        launch = mujoco.viewer.launch_passive
    try:
        window = launch(view.model, view.drawn, key_callback=view.key)
    except RuntimeError as error:
        raise InputError(f"view: no window: {error}. {NO_DISPLAY}") from error
    with window:
        begun = last = time.monotonic()
        while window.is_running() and not view.run.finished:
            now = time.monotonic()
            if seconds is not None and now - begun >= seconds:
                break
            with window.lock():
                view.pull(window.perturb)
                view.step(now - last)
            last = now
            window.set_texts((None, None, view.text(), ""))
            window.sync()
            if view.wants_saving and save is not None:
                save(view.run)
            view.wants_saving = False
            time.sleep(max(0.0, 1.0 / 60.0 - (time.monotonic() - now)))
