"""What a film is made of: pictures of a model without a display, and traces that grow."""

import copy
import importlib
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple, Self

import mujoco
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from cmf_mj.core import units
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.machine.geometry import DOFS, by_kind, dof_unit
from cmf_mj.record.record import Record
from cmf_mj.show.look import BLUE, DARK, GREEN, GREY, ORANGE, Curve, Panel, plot_panel

BACKENDS = ("egl", "osmesa")  #: Off-screen OpenGL, in the order in which they are tried.

PACKAGES = (
    "on Debian or Ubuntu install libegl1 and libgl1-mesa-dri (MUJOCO_GL=egl) "
    "or libosmesa6 (MUJOCO_GL=osmesa)"
)

_SHADOWS = 4096
"""Shadow map at most [texels]; small pictures have one of about four texels a pixel."""

_FINER = 2  #: Pixels drawn for one of the picture, each way.

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


_DPI = 100
_MOST = 3  #: Panels one above the other.
_PALE = 0.16  #: How much of the traces shows before their time has come.
_LEAST = 0.02  #: Least range of an axis, in its unit.
_CURSOR = (200, 30, 30)

Panels = Sequence[Panel]  #: What the strip of a run shows, from above, one column after the other.


class Reel(NamedTuple):
    """What one part of each picture shows."""

    model: mujoco.MjModel  #: The machine.
    time: NDArray[np.float64]  #: Of its configurations, rising [s], (n,).
    qpos: NDArray[np.float64]  #: Its configurations, (n, nq).
    title: str  #: Over the picture.
    traces: Panels = ()  #: Under the picture.


UNITS = {"US": ("in", "deg", "psi", "lbf"), "metric": ("mm", "deg", "bar", "kN")}
"""Units of lengths, angles, pressures and forces, by their system."""


def busiest_leg(*records: Record) -> int:
    """The leg, from 0, whose cap pressure moves most."""
    return int(np.max([np.ptp(one["cap_pressure"], axis=0) for one in records], axis=0).argmax())


def traces_of(record: Record, system: str = "US", leg: int | None = None) -> Panels:
    """A degree of freedom of a record, and pressures of a leg, the busiest by default.

    It is the one whose demand, or without one whose response, moves most, lengths against 1 in and
    angles against 1 deg. The system is one of `UNITS`.
    """
    length, angle, pressure, _ = UNITS[system]
    leg = busiest_leg(record) if leg is None else leg

    def line(
        name: str, channel: str, column: int, unit: str, colour: str, width: float = 1.0
    ) -> Curve:
        values = record[channel].reshape(record.time.size, -1)[:, column]
        return Curve(name, record.time, values / units.factor(unit), colour, width=width)

    title, column, unit = f"leg {leg + 1}", leg, length
    demand, response = "leg_reference", "leg_extension"
    if "platform_pose" in record.channels:
        demand, response = "demand_pose", "platform_pose"
        scale = np.array([units.factor(dof_unit(name)) for name in DOFS])
        moved = record.channels.get(demand, record[response]) / scale
        column = int(np.ptp(moved, axis=0).argmax())
        title, unit = DOFS[column], by_kind(column, length, angle)
    motion = [line("response", response, column, unit, BLUE, 1.2)]
    if demand in record.channels:
        motion.insert(0, line("demand", demand, column, unit, GREY, 2.2))
    pressures = (
        line("cap", "cap_pressure", leg, pressure, ORANGE),
        line("rod", "rod_pressure", leg, pressure, GREEN),
        line("supply", "supply_pressure", 0, pressure, DARK),
    )
    below = Panel(f"leg {leg + 1} [{pressure}]", pressures, from_zero=True)
    return Panel(f"{title} [{unit}]", tuple(motion)), below


class Strip:
    """Traces as a picture, revealed from left to right."""

    def __init__(
        self,
        panels: Panels,
        width: int,
        height: int,
        span: tuple[float, float],
        every: Sequence[Panels] = (),
    ) -> None:
        """Draw them once, over a span of time [s]; panels of the same curves share one legend.

        The axes take in the range of the panels of `every` run.
        """
        if not panels:
            raise InputError("panels: none is given; give at least one")
        self._span, columns = span, -(-len(panels) // _MOST)
        rows = -(-len(panels) // columns)
        size, letters = (width / _DPI, height / _DPI), min(8.0, height / (12.0 * rows))
        small: dict[str, Any] = {"fontsize": letters - 1.0, "frameon": False}
        figure = Figure(figsize=size, dpi=_DPI, facecolor="white")
        figure.set_layout_engine("constrained", w_pad=0.06, h_pad=0.04)
        grid = figure.subplots(rows, columns, sharex=True, squeeze=False)
        shared = len({tuple(curve.name for curve in panel.curves) for panel in panels}) == 1
        axes = list(grid.T.ravel())[: len(panels)]
        for axis, panel, *others in zip(axes, panels, *(every or [panels]), strict=True):
            plot_panel(axis, panel)
            axis.yaxis.label.set_fontsize(letters)
            axis.set(xlim=span, ylim=limits_of(others, span))
            axis.grid(True, color="0.92", linewidth=0.6)
            axis.tick_params(labelsize=letters - 1.0)
            if not shared:
                axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), **small)
        for column in grid.T:
            drawn = [axis for axis in column if axis.has_data()]
            drawn[-1].set_xlabel("time [s]", fontsize=letters)
            drawn[-1].tick_params(labelbottom=True)
        for axis in grid.flat:
            axis.set_visible(axis.has_data())
        if shared:
            lines = axes[0].lines
            below: dict[str, Any] = {"loc": "outside lower center", "ncols": len(lines)}
            figure.legend(handles=lines, **below, **(small | {"fontsize": letters}))
        figure.align_ylabels()
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        full = np.asarray(canvas.buffer_rgba())[:, :, :3].astype(np.uint8)
        self._full = full[:height, :width]
        self._pale = (255 - _PALE * (255.0 - self._full)).astype(np.uint8)
        self._boxes = []
        for axis in axes:
            (left, low), (right, high) = axis.get_window_extent().get_points().round().astype(int)
            self._boxes.append((slice(height - high + 1, height - low - 1), left + 1, right - 1))

    def picture(self, time: float) -> NDArray[np.uint8]:
        """The strip at a time [s], (height, width, 3)."""
        share = float(np.interp(time, self._span, (0.0, 1.0)))
        pixels = self._full.copy()
        for rows, left, right in self._boxes:
            cursor = left + round(share * (right - left - 1))
            pixels[rows, cursor:right] = self._pale[rows, cursor:right]
            pixels[rows, cursor : cursor + 2] = _CURSOR
        return pixels


def samples_within(
    curve: Curve, span: tuple[float, float]
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Times and values of a curve within a span of time; at its ends where no sample is in it."""
    inside = (curve.x >= span[0]) & (curve.x <= span[1])
    if inside.any():
        return curve.x[inside], curve.y[inside]
    return np.array(span), np.interp(span, curve.x, curve.y)


def limits_of(panels: Panels, span: tuple[float, float]) -> tuple[float, float]:
    """Ends of an axis that holds the curves of all panels within a span of time."""
    curves = [curve for panel in panels for curve in panel.curves]
    values = np.concatenate([samples_within(curve, span)[1] for curve in curves])
    low, high = float(values.min()), float(values.max())
    if panels[0].from_zero:
        return min(0.0, low), max(1.08 * high, _LEAST)
    margin = 0.08 * max(high - low, _LEAST)
    return low - margin, high + margin
