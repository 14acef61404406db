"""Scene and live plots of a tab; uPlot draws thousands of points without effort."""

from collections.abc import Sequence

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
from cmf_mj.show.studio.live import PLOT_RATE, Mark, View

_DARK, _PALE, RED = "#222222", "#8a9099", "#d62728"


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
        # One for each title: a plot whose title changes loses its time axis in the browser.
        self._response = {
            f"{dof} [{unit}]": _add_plot(client, f"platform, {dof} [{unit}]", both, -least, least)
            for dof in DOFS
            for unit, least in by_kind(dof, (("in", 0.05), ("mm", 1.0)), (("deg", 0.05),))
        }
        self._force = _add_plot(client, "leg forces [kN]", legs, 20.0, 40.0)
        self._valve = _add_plot(client, "valve commands [%]", legs, -2.0, 2.0)
        sides = [("cap", BLUE, False), ("rod", ORANGE, False)]
        manifolds = [("supply", _DARK, False), ("return", _PALE, True)]
        tops = (("psi", 1000.0), ("bar", 70.0))
        self._pressure = {
            unit: _add_plot(client, f"pressures of the leg [{unit}]", sides, 0.0, top)
            for unit, top in tops
        }
        self._supply = {
            unit: _add_plot(client, f"manifolds [{unit}]", manifolds, 0.0, 2.0 * top)
            for unit, top in tops
        }

    def show(self, view: View, seconds: float, dof: str, system: str, leg: int) -> None:
        """Draw the last seconds in `UNITS`: a degree of freedom, pressures of a leg from 0.

        Without one the translation that moves most.
        """
        rows = round(seconds * PLOT_RATE)
        past: list[Live] = list(view.past)[-rows:]
        beside: list[Live | None] = list(view.beside)[-rows:]
        if len(past) < 2:
            return
        length, angle, pressure = UNITS[system]
        if not dof:
            dof = DOFS[int(np.ptp([live.demand[:3] for live in past], axis=0).argmax())]
        index, unit = DOFS.index(dof), by_kind(dof, length, angle)
        shown = f"{dof} [{unit}]"

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
        for plots, drawn in (
            (self._response, shown),
            (self._pressure, pressure),
            (self._supply, pressure),
        ):
            for name, plot in plots.items():
                plot.visible = name == drawn
        self._response[shown].data = (time, of("demand", unit)[index], *responses, *marked)
        self._force.data = (time, *of("force", "kN"), *marked)
        self._valve.data = (time, *of("valve_command", "%"), *marked)
        pressures = of("cap_pressure", pressure)[leg], of("rod_pressure", pressure)[leg]
        self._pressure[pressure].data = (time, *pressures, *marked)
        manifolds = *of("supply_pressure", pressure), *of("return_pressure", pressure)
        self._supply[pressure].data = (time, *manifolds, *marked)


_PUSH_LENGTH = 5.0  #: Length of the arrow of the largest push [m].

_CAB_CENTRE = np.array([0.0, 0.0, 1.7])  #: Where the arrow points, from the platform [m].

_CLEAR = 2.4  #: Distance of its tip from there, outside the cab [m].

_HEIGHT, _WIDTH = 0.62, 0.85
"""Angles that hold the machine with its longest cab, seen from the first view [rad]."""


def place_camera(client: viser.ClientHandle) -> None:
    """Put a tab's camera at the first view; it holds the machine in a picture of any shape."""
    camera = client.camera
    # From the right front, a little above the platform [m, rad].
    camera.position, camera.look_at = (10.6, -10.4, 1.6), (0.0, 0.0, -0.75)

    @camera.on_update
    def _(_: viser.CameraHandle) -> None:
        narrow = np.tan(0.5 * _WIDTH) / camera.aspect
        angle = 2.0 * float(np.arctan(max(np.tan(0.5 * _HEIGHT), narrow)))
        if abs(camera.fov - angle) > 0.01:
            camera.fov = angle


class MachineScene:
    """The hexapod with one cab in one tab, and the push on it."""

    def __init__(self, client: viser.ClientHandle, cab: Cab) -> None:
        """Send the geometry, in the place of all that the tab showed."""
        self.cab = cab
        """The cab in the scene."""
        self._client = client
        client.scene.reset()
        self._light()
        # A new model: the scene scales the looks of its model.
        self._model = hexapod_model(cab)
        self._data = mujoco.MjData(self._model)
        with client.atomic():
            self._machine = ViserMujocoScene(client, self._model, num_envs=1)
            # Lights alone: mirroring an environment takes seconds where no GPU helps.
            client.scene.configure_environment_map(None)
        self._machine.camera_tracking_enabled = False
        self._platform = self._model.body("platform").id
        self._push: viser.SceneNodeHandle | None = None
        self._pushed = np.zeros(3)
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

    def show_push(self, share: ArrayLike) -> None:
        """Draw the push, a share (3,) of the largest, as an arrow that points at the cab."""
        along = np.asarray(share, dtype=float)
        if not np.array_equal(along, self._pushed):
            self._pushed, self._push = along, None
            self._client.scene.remove_by_name("/push")
            if along.any():
                tip = _CAB_CENTRE - _CLEAR * along / np.linalg.norm(along)
                self._push = self._client.scene.add_arrows(
                    "/push",
                    points=np.array([[tip - _PUSH_LENGTH * along, tip]], dtype=np.float32),
                    colors=(214, 39, 40),
                    shaft_radius=0.07,
                    head_radius=0.18,
                    head_length=0.4,
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
