"""Pictures of a model without a display.

OpenGL comes from MUJOCO_GL if it is set. Otherwise, on Linux without a display, EGL and then OSMesa
are tried, each in a new process: in one process the first try would settle the platform.
"""

import copy
import importlib
import os
import subprocess
import sys
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Self

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from cmf_mj.core.errors import InputError, check_name

BACKENDS = ("egl", "osmesa")
"""Off-screen OpenGL, in the order in which they are tried."""

PACKAGES = (
    "on Debian or Ubuntu install libegl1 and libgl1-mesa-dri (MUJOCO_GL=egl) "
    "or libosmesa6 (MUJOCO_GL=osmesa)"
)

_SHADOWS = 4096
"""Shadow map at most [texels]; small pictures have one of about four texels a pixel."""

_FINER = 2
"""Pixels drawn for one of the picture, each way."""

_TRY = "import importlib, sys; importlib.import_module('mujoco.' + sys.argv[1]).GLContext(8, 8)"


def choose_backend(environment: Mapping[str, str] | None = None) -> str:
    """Name of MuJoCo's OpenGL module to use: egl, osmesa, glfw or cgl; refused if none works."""
    variables = os.environ if environment is None else environment
    named = variables.get("MUJOCO_GL", "").lower().strip()
    if named in ("egl", "osmesa", "glfw", "cgl"):
        return named
    if named:
        raise InputError(f"MUJOCO_GL: {named!r} is not one of egl, osmesa, glfw, cgl")
    if sys.platform != "linux" or any(map(variables.get, ("DISPLAY", "WAYLAND_DISPLAY"))):
        return "cgl" if sys.platform == "darwin" else "glfw"
    for backend in BACKENDS:
        if _works(backend):
            return backend
    raise InputError(f"MUJOCO_GL: no off-screen OpenGL works here; {PACKAGES}")


@lru_cache
def _works(backend: str) -> bool:
    environment = {k: v for k, v in os.environ.items() if k != "PYOPENGL_PLATFORM"}
    command = [sys.executable, "-c", _TRY, backend]
    return subprocess.run(command, env=environment, capture_output=True).returncode == 0


class FilmStage:
    """A model, a camera and a buffer to render into; use it in a `with` block."""

    def __init__(
        self, model: mujoco.MjModel, width: int, height: int, camera: str = "overview"
    ) -> None:
        """Open an off-screen buffer of width x height pixels, at most those of the model."""
        for name, value in (("width", width), ("height", height)):
            most = getattr(model.vis.global_, f"off{name}")
            if not 16 <= value <= most:
                raise InputError(f"{name}: {value} pixels must be between 16 and {most}")
        check_name("camera", camera, [model.camera(i).name for i in range(model.ncam)])
        # Software OpenGL pays for vertices, for the shadow map and, most of all, for
        # multisampling: twice the pixels each way, averaged, look as good for 60 % of the time.
        model = copy.copy(model)
        quality, buffer = model.vis.quality, model.vis.global_
        buffer.offwidth, buffer.offheight = _FINER * width, _FINER * height
        quality.offsamples, quality.numslices, quality.numstacks = 0, 20, 10
        quality.shadowsize = min(quality.shadowsize, _SHADOWS, 1 << (4 * width - 1).bit_length())
        self._data = mujoco.MjData(model)
        self._camera = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._camera.fixedcamid = model.camera(camera).id
        self._option = mujoco.MjvOption()
        self._rectangle = mujoco.MjrRect(0, 0, _FINER * width, _FINER * height)
        self.model, self.shape = model, (height, width, 3)
        backend = choose_backend()
        try:
            platform: Any = importlib.import_module(f"mujoco.{backend}")
            self._gl = platform.GLContext(_FINER * width, _FINER * height)
        except Exception as error:  # PyOpenGL raises whatever its platform does
            said = f"MUJOCO_GL: {backend} does not work here ({error}); {PACKAGES}"
            raise InputError(said) from error
        self._gl.make_current()
        self._scene = mujoco.MjvScene(model=model, maxgeom=10_000)
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)

    def __enter__(self) -> Self:
        """Nothing more to open."""
        return self

    def __exit__(self, *_: object) -> None:
        """Give the buffer back."""
        self._gl.make_current()
        self._context.free()
        self._gl.free()

    def picture(self, qpos: NDArray[np.float64]) -> NDArray[np.uint8]:
        """The model in a configuration (nq,), as pixels (height, width, 3)."""
        self._data.qpos[:] = qpos
        mujoco.mj_forward(self.model, self._data)
        self._gl.make_current()
        look = self._option, None, self._camera, mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(self.model, self._data, *look, self._scene)
        height, width, _ = self.shape
        pixels = np.empty((_FINER * height, _FINER * width, 3), dtype=np.uint8)
        mujoco.mjr_render(self._rectangle, self._scene, self._context)
        mujoco.mjr_readPixels(pixels, None, self._rectangle, self._context)
        upright = Image.fromarray(np.ascontiguousarray(pixels[::-1]))
        return np.asarray(upright.reduce(_FINER))
