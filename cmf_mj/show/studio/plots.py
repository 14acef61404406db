"""Scene and live plots of a tab; uPlot draws thousands of points without effort."""

from collections.abc import Sequence

import mujoco
import numpy as np
import viser
from mjviser import ViserMujocoScene
from numpy.typing import ArrayLike, NDArray
from viser import uplot

from cmf_mj.core import units
from cmf_mj.machine.cab import Cab
from cmf_mj.machine.dof import dof_unit
from cmf_mj.machine.geometry import DOFS
from cmf_mj.plant.hexapod import hexapod_model
from cmf_mj.show.look import BLUE, COLOURS, ORANGE
from cmf_mj.show.studio.live import PLOT_RATE, View

_DARK, _PALE = "#222222", "#8a9099"


def _add_plot(
    client: viser.ClientHandle,
    title: str,
    lines: Sequence[tuple[str, str]],
    low: float,
    high: float,
    dashed: str = "",
) -> viser.GuiUplotHandle:
    """Add an empty plot over time of lines, each a label and a colour.

    Its axis reaches from `low` to `high` at least, so that round-off does not fill it.
    """
    least, most = ({"pad": 0.1, "soft": limit, "mode": 1} for limit in (low, high))
    series = [uplot.Series(label="t [s]")]
    for label, colour in lines:
        series.append(uplot.Series(label=label, stroke=colour, width=1.5))
        if label == dashed:
            series[-1]["dash"] = (5.0, 4.0)
    font, ticks = "11px sans-serif", uplot.Axis_Ticks(size=4, width=1)
    return client.gui.add_uplot(
        (np.zeros(2),) * len(series),
        tuple(series),
        title=title,
        scales={
            "x": uplot.Scale(time=False),
            "y": uplot.Scale(range={"min": least, "max": most}),
        },
        axes=(
            uplot.Axis(size=34, font=font, ticks=ticks, gap=4),
            uplot.Axis(size=46, font=font, ticks=ticks),
        ),
        legend=uplot.Legend(show=True, live=False),
        height=150,
        padding=(10, 12, 0, 0),
    )


class Plots:
    """The five plots of a tab."""

    def __init__(self, client: viser.ClientHandle) -> None:
        """Add them to the container in force."""
        legs = [(str(leg), colour) for leg, colour in zip(range(1, 7), COLOURS, strict=False)]
        both = [("demand", _DARK), ("response", BLUE)]
        self._response = {
            unit: _add_plot(client, f"platform [{unit}]", both, -0.05, 0.05, "demand")
            for unit in ("in", "deg")
        }
        self._force = _add_plot(client, "leg forces [kN]", legs, 20.0, 40.0)
        self._valve = _add_plot(client, "valve commands [%]", legs, -2.0, 2.0)
        sides = [("cap", BLUE), ("rod", ORANGE)]
        self._pressure = _add_plot(client, "pressures of the leg [psi]", sides, 0.0, 1000.0)
        manifolds = [("supply", _DARK), ("return", _PALE)]
        self._supply = _add_plot(client, "manifolds [psi]", manifolds, 0.0, 2000.0, "return")

    def show(self, view: View, seconds: float, dof: str, leg: int) -> None:
        """Draw the last seconds: a degree of freedom, and the pressures of a leg from 0."""
        past = list(view.past)[-round(seconds * PLOT_RATE) :]
        if len(past) < 2:
            return
        index, unit = DOFS.index(dof), dof_unit(dof)

        def of(name: str, in_unit: str) -> list[NDArray[np.float64]]:
            """A signal, column by column."""
            values = units.from_si(in_unit, np.array([getattr(live, name) for live in past]))
            return list(np.ascontiguousarray(np.atleast_2d(values.T)))

        time = of("time", "s")[0]
        pose = view.plant.pose_of(np.array([live.qpos for live in past]))
        response = units.from_si(unit, pose[:, index])
        for name, plot in self._response.items():
            plot.visible = name == unit
        self._response[unit].data = (time, of("demand", unit)[index], response)
        self._force.data = (time, *of("force", "kN"))
        self._valve.data = (time, *of("valve_command", "%"))
        pressures = of("cap_pressure", "psi")[leg], of("rod_pressure", "psi")[leg]
        self._pressure.data = (time, *pressures)
        self._supply.data = (time, *of("supply_pressure", "psi"), *of("return_pressure", "psi"))


_PUSH_LENGTH = 5.0
"""Length of the arrow of the largest push [m]."""

_CAB_CENTRE = np.array([0.0, 0.0, 1.7])
"""Where the arrow points, from the platform [m]."""

_CLEAR = 2.4
"""Distance of its tip from there, outside the cab [m]."""


def place_camera(client: viser.ClientHandle) -> None:
    """Put a tab's camera at the first view."""
    # From the right front, a little above the platform [m, rad].
    client.camera.position, client.camera.look_at = (10.6, -10.4, 1.6), (0.0, 0.0, -0.75)
    client.camera.fov = 0.62


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
