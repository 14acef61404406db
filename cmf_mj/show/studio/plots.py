"""Scene and live plots of a tab; uPlot draws thousands of points without effort."""

from collections.abc import Sequence
from html import escape

import mujoco
import numpy as np
import viser
from mjviser import ViserMujocoScene
from numpy.typing import ArrayLike, NDArray
from viser import uplot

from cmf_mj.core import units
from cmf_mj.facility.session import Live
from cmf_mj.machine.cab import Cab
from cmf_mj.machine.geometry import DOFS, by_kind
from cmf_mj.plant.hexapod import hexapod_model
from cmf_mj.show.look import BLUE, GREEN, ORANGE
from cmf_mj.show.stage import UNITS
from cmf_mj.show.studio.desk import LARGEST_PUSH, weight
from cmf_mj.show.studio.live import PLOT_RATE, Mark, View, words

_DARK, _PALE, RED, _GOOD, _FAILED = "#222222", "#8a9099", "#d62728", "#2f9e44", "#f08c00"

_MOTION, _FORCE, _VALVE = "platform, {} [{}]", "leg forces [{}]", "valve commands [%]"
_PRESSURE, _SUPPLY = "pressures of the leg [{}]", "manifolds [{}]"


def lamp(view: View) -> str:
    """HTML of a lamp: green; amber while something has failed; red once it tripped or ended."""
    harm = [mark for mark in view.marks if mark.harm]
    colour, says = _GOOD, "all works"
    if view.end:
        colour, says = RED, f"ended: {view.end}"
    elif (fault := view.live.fault) is not None:
        colour, says = RED, f"tripped: {words(fault.name, fault.leg)}"
    elif harm or view.live.late:
        colour, says = _FAILED, "failed" if harm else "host late"
    marks = "".join(f"<br>{mark.time:.1f} s: {escape(mark.text)}" for mark in view.marks[-3:])
    dot = f"<span style='color:{colour};font-size:1.6em;line-height:0.6'>&#9679;</span>"
    return f"<div style='padding:0 0.8em;font-size:0.9em'>{dot} <b>{escape(says)}</b>{marks}</div>"


def _add_plot(
    client: viser.ClientHandle,
    title: str,
    lines: Sequence[tuple[str, str, bool]],
    low: float,
    high: float,
) -> viser.GuiUplotHandle:
    """Add an empty plot over time of lines, each a label, a colour and whether it is dashed.

    Its axis reaches from `low` to `high` at least, so that round-off does not fill it. Two lines
    more rise from the lower edge to the upper where something changed, failed or tripped.
    """
    least, most = ({"pad": 0.1, "soft": limit, "mode": 1} for limit in (low, high))
    series = [uplot.Series(label="t [s]")]
    for label, colour, dashed in lines:
        series.append(uplot.Series(label=label, stroke=colour, width=1.5))
        if dashed:
            series[-1]["dash"] = (5.0, 4.0)
    for label, colour in (("changed", _PALE), ("failed", RED)):
        series.append(uplot.Series(label=label, stroke=colour, width=1.5, scale="mark"))
        series[-1]["points"] = uplot.Series_Points(show=False)
    font, ticks = "11px sans-serif", uplot.Axis_Ticks(size=4, width=1)
    return client.gui.add_uplot(
        (np.zeros(2),) * len(series),
        tuple(series),
        title=title,
        scales={
            "x": uplot.Scale(time=False),
            "y": uplot.Scale(range={"min": least, "max": most}),
            "mark": uplot.Scale(auto=False, range=(0.0, 1.0)),
        },
        axes=(
            uplot.Axis(size=34, font=font, ticks=ticks, gap=4),
            uplot.Axis(size=46, font=font, ticks=ticks),
        ),
        legend=uplot.Legend(show=True, live=False),
        height=150,
        padding=(10, 12, 0, 0),
    )


def spikes(
    time: NDArray[np.float64], marks: Sequence[Mark]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lines that rise from below 0 to 1 at the time of each mark: of changes, and of harm."""
    lines = np.full((2, time.size), -1.0)
    for mark in marks:
        if time[0] <= mark.time <= time[-1]:
            lines[int(mark.harm), np.searchsorted(time, mark.time)] = 1.0
    return lines[0], lines[1]


class Plots:
    """The five plots of a tab."""

    def __init__(self, client: viser.ClientHandle) -> None:
        """Add them to the container in force."""
        # Mirrored legs have one colour and the left ones are dashed: both show where they agree.
        mirrored = (BLUE, ORANGE, GREEN, GREEN, ORANGE, BLUE)
        legs = [(str(leg), colour, leg > 3) for leg, colour in enumerate(mirrored, 1)]
        both = [("demand", _DARK, True), ("second law", ORANGE, False), ("response", BLUE, False)]
        sides = [("cap", BLUE, False), ("rod", ORANGE, False)]
        manifolds = [("supply", _DARK, False), ("return", _PALE, True)]
        # One for each title: a plot whose title changes loses its time axis in the browser.
        drawn = {_MOTION.format(dof, "deg"): (both, -0.05, 0.05) for dof in DOFS[3:]}
        for unit, least in (("in", 0.05), ("mm", 1.0)):
            drawn |= {_MOTION.format(dof, unit): (both, -least, least) for dof in DOFS[:3]}
        drawn |= {_FORCE.format(unit): (legs, 0.0, 1.0) for unit in ("lbf", "kN")}
        drawn[_VALVE] = legs, -2.0, 2.0
        for title, lines, psi in ((_PRESSURE, sides, 1000.0), (_SUPPLY, manifolds, 2000.0)):
            for unit, size in (("psi", 1.0), ("bar", 0.07)):
                drawn[title.format(unit)] = lines, 0.0, size * psi
        self._plots = {title: _add_plot(client, title, *how) for title, how in drawn.items()}

    def show(self, view: View, seconds: float, dof: str, system: str, leg: int) -> None:
        """Draw the last seconds in `UNITS`: a degree of freedom, pressures of a leg from 0.

        Without one the translation that moves most.
        """
        rows = round(seconds * PLOT_RATE)
        past: list[Live] = list(view.past)[-rows:]
        beside: list[Live | None] = list(view.beside)[-rows:]
        if len(past) < 2:  # a run that begins, or waits
            past, beside = [view.live] * 2, [None] * 2
        length, angle, pressure, force = UNITS[system]
        if not dof:
            dof = DOFS[int(np.ptp([live.demand[:3] for live in past], axis=0).argmax())]
        index, unit = DOFS.index(dof), by_kind(dof, length, angle)

        def of(name: str, in_unit: str) -> list[NDArray[np.float64]]:
            """A signal, column by column."""
            values = units.from_si(in_unit, np.array([getattr(live, name) for live in past]))
            return list(np.ascontiguousarray(np.atleast_2d(values.T)))

        time = of("time", "s")[0]
        marked = spikes(time, view.marks)
        # Without a second machine its line lies below that of the first: a gap has no scale.
        lives = [second or live for second, live in zip(beside, past, strict=True)] + past
        poses = view.plant.pose_of(np.array([live.qpos for live in lives]))
        responses = units.from_si(unit, poses[:, index]).reshape(2, -1)
        drawn = {
            _MOTION.format(dof, unit): (of("demand", unit)[index], *responses),
            _FORCE.format(force): of("force", force),
            _VALVE: of("valve_command", "%"),
            _PRESSURE.format(pressure): [
                of(f"{s}_pressure", pressure)[leg] for s in ("cap", "rod")
            ],
            _SUPPLY.format(pressure): of("supply_pressure", pressure)
            + of("return_pressure", pressure),
        }
        for title, plot in self._plots.items():
            plot.visible = title in drawn
            if plot.visible:
                plot.data = (time, *drawn[title], *marked)


_AIM, _FROM = np.array([0.0, 0.0, -0.115]), np.array([1.63, -1.6, 0.245])
"""Where the first view looks and from where, the right front, in extents of the machine."""

_PUSH_LENGTH = 0.77  #: Length of the arrow of the largest push [extents].

_CAB_CENTRE = np.array([0.0, 0.0, 0.26])  #: Where the arrow points, from the platform [extents].

_CLEAR = 0.37  #: Distance of its tip from there, outside the cab [extents].

_HEIGHT, _WIDTH = 0.62, 0.85
"""Angles that hold the machine with its longest cab, seen from the first view [rad]."""


def widen_camera(client: viser.ClientHandle) -> None:
    """Let a tab's camera hold the machine in a picture of any shape."""

    @client.camera.on_update
    def _(camera: viser.CameraHandle) -> None:
        narrow = np.tan(0.5 * _WIDTH) / camera.aspect
        angle = 2.0 * float(np.arctan(max(np.tan(0.5 * _HEIGHT), narrow)))
        if abs(camera.fov - angle) > 0.01:
            camera.fov = angle


class MachineScene:
    """The hexapod with one cab in one tab, and the push on it."""

    def __init__(self, client: viser.ClientHandle, cab: Cab, seen: float = 0.0) -> None:
        """Send the geometry, in the place of all that the tab showed, of an extent `seen` [m]."""
        self.cab = cab
        """The cab in the scene."""
        self._client = client
        client.scene.reset()
        self._light()
        # A new model: the scene scales the looks of its model.
        self._model = hexapod_model(cab)
        self._data = mujoco.MjData(self._model)
        self.extent = float(self._model.stat.extent)
        """Size of the machine, by which the first view and the arrows are made [m]."""
        if self.extent != seen:
            client.camera.position, client.camera.look_at = self.extent * _FROM, self.extent * _AIM
        with client.atomic():
            self._machine = ViserMujocoScene(client, self._model, num_envs=1)
            # Lights alone: mirroring an environment takes seconds where no GPU helps.
            client.scene.configure_environment_map(None)
        self._machine.camera_tracking_enabled = False
        self._platform = self._model.body("platform").id
        self._push: viser.SceneNodeHandle | None = None
        self._pushed = np.zeros(3)
        self._most = 0.01 * LARGEST_PUSH * weight(cab)
        self.show(self._data.qpos)

    @property
    def platform_position(self) -> NDArray[np.float64]:
        """Where the platform is drawn, model's axes (z up) [m], (3,)."""
        return self._data.xpos[self._platform].copy()

    def show(self, qpos: ArrayLike) -> None:
        """Move everything to generalised positions (nq,)."""
        self._data.qpos[:] = np.asarray(qpos, dtype=float)
        mujoco.mj_kinematics(self._model, self._data)
        self._machine.update_from_mjdata(self._data)

    def show_push(self, force: NDArray[np.float64]) -> None:
        """Draw a push (3,) [N] as an arrow that points at the cab."""
        along = force / self._most
        if not np.array_equal(along, self._pushed):
            self._pushed, self._push = along, None
            self._client.scene.remove_by_name("/push")
            if along.any():
                tip = _CAB_CENTRE - _CLEAR * along / np.linalg.norm(along)
                ends = self.extent * np.array([[tip - _PUSH_LENGTH * along, tip]])
                self._push = self._client.scene.add_arrows(
                    "/push",
                    points=ends.astype(np.float32),
                    colors=(214, 39, 40),
                    shaft_radius=0.011 * self.extent,
                    head_radius=0.028 * self.extent,
                    head_length=0.06 * self.extent,
                )
        if self._push is not None:
            self._push.position = self.platform_position

    def _light(self) -> None:
        """Lights of a fresh scene; the hall hides the background."""
        scene = self._client.scene
        scene.configure_default_lights(enabled=False)
        scene.add_light_ambient("/lights/ambient", intensity=1.7)
        scene.add_light_directional("/lights/fill", intensity=1.2, position=(-6.0, 7.0, 6.0))
        # Without shadows: a browser without a GPU draws less than a picture a second with them.
        key = {"intensity": 2.8, "position": (6.0, -8.0, 9.0), "cast_shadow": False}
        scene.add_light_directional("/lights/key", **key)
