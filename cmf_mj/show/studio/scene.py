"""The machine in three dimensions: one scene a browser tab, moved by generalised positions."""

import mujoco
import numpy as np
import viser
from mjviser import ViserMujocoScene
from numpy.typing import ArrayLike, NDArray

from cmf_mj.machine.cab import Cab
from cmf_mj.plant.hexapod import hexapod_model

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
