"""Films of the hydraulic modes: six panels, each the machine swinging in one mode, far exaggerated.

All panels run at one slow rate, so that their periods stand in the true ratio.
"""

import copy
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from cmf_mj.analysis.modes import largest_stroke, swinging
from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.machine.kinematics import DOFS, WORKING_STROKE
from cmf_mj.plant.hexapod import Hexapod, HydraulicModes
from cmf_mj.show.film.encoding import check_format, write_film
from cmf_mj.show.film.stage import Stage

COLUMNS = 3
"""Panels side by side."""

LEAST_PICTURES = 4
"""Pictures in a period of the fastest mode, at least."""

_INK = (34, 34, 34)

_WIDER = 1.15
"""Angle of view over that of the model's cameras."""


class SwingSettings(NamedTuple):
    """How a film of modes looks."""

    fps: int = 15  #: Pictures a second.
    speed: float = 0.05  #: Times real speed, the same for all modes.
    camera: str = "overview"  #: Camera of the model.
    width: int = 320  #: Of the picture of one mode [pixels], even.
    height: int = 260  #: [pixels], even.
    stroke: float = 12.0 * units.INCH
    """Largest leg motion of each mode [m]; less where a leg would leave its working stroke."""
    periods: float = 1.0  #: Length of the film, in periods of the lowest mode.


class Swing(NamedTuple):
    """One panel."""

    caption: str  #: Two lines: mode, frequency, mass a leg feels; leading share, leg motion.
    qpos: NDArray[np.float64]  #: MuJoCo's configuration in each picture, (n, nq).


def swing_film(
    plant: Hexapod,
    modes: HydraulicModes,
    path: str | Path,
    settings: SwingSettings | None = None,
    *,
    title: str = "",
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Render the modes at a pose to an MP4 or GIF file; it appears only when it is complete.

    Args:
        plant: the hexapod; it is left in some configuration of the film.
        modes: modes at the pose about which it swings.
        path: ends in .mp4 or .gif.
        settings: how it looks.
        title: over the film; default the cab.
        progress: called with the pictures done and those in all.

    Raises:
        InputError: an argument out of range or a missing package, named.
    """
    chosen, target = settings or SwingSettings(), Path(path)
    check_format(target, chosen.fps, chosen.speed, {"width": chosen.width, "height": chosen.height})
    time = film_time(modes, chosen)
    swings = [one_swing(plant, modes, mode, time, chosen.stroke) for mode in range(6)]
    named = f"{title or modes.cab.upper()}\nhydraulic modes, {pace_text(chosen.speed)}, exaggerated"
    pictures = _pictures(_framed(plant, modes), swings, time, named, chosen)
    return write_film(pictures, time.size, target, chosen.fps, progress=progress)


def film_time(modes: HydraulicModes, chosen: SwingSettings) -> NDArray[np.float64]:
    """Time of the machine in each picture (n,) [s]; refused if the fastest mode has too few."""
    if not (np.isfinite(chosen.periods) and chosen.periods > 0.0):
        raise InputError(f"periods: {chosen.periods} of the lowest mode must be greater than 0")
    fastest = float(modes.frequency_hz[-1])
    most = chosen.fps / (LEAST_PICTURES * fastest)
    if chosen.speed > most:
        raise InputError(
            f"speed: {chosen.speed} with {chosen.fps} pictures a second leaves mode 6 at "
            f"{fastest:.1f} Hz fewer than {LEAST_PICTURES} a period; must be at most {most:.3g}"
        )
    length = chosen.periods / (float(modes.frequency_hz[0]) * chosen.speed)
    return np.arange(max(round(length * chosen.fps), 1)) * chosen.speed / chosen.fps


def one_swing(
    plant: Hexapod, modes: HydraulicModes, mode: int, time: NDArray[np.float64], stroke: float
) -> Swing:
    """A panel: the mode with the leg motion asked for [m], or what the working stroke leaves."""
    if not 0.0 < stroke <= WORKING_STROKE:
        raise InputError(
            f"stroke: {stroke:.4f} m must be greater than 0 and at most {WORKING_STROKE:.4f} m"
        )
    motion = min(stroke, largest_stroke(plant, modes, mode))
    leading = int(modes.share[:, mode].argmax())
    caption = (
        f"mode {mode + 1}: {modes.frequency_hz[mode]:.2f} Hz, "
        f"{units.from_si('lbm', modes.leg_mass[mode]):.0f} lbm a leg\n"
        f"{DOFS[leading]} {100.0 * modes.share[leading, mode]:.0f} %, "
        f"legs ±{units.from_si('in', motion):.1f} in"
    )
    return Swing(caption, swinging(plant, modes, mode, time, stroke=motion))


def pace_text(speed: float) -> str:
    """A speed in words."""
    if speed == 1.0:
        return "at real speed"
    return f"{1.0 / speed:.4g} times slower" if speed < 1.0 else f"{speed:.4g} times faster"


def _framed(plant: Hexapod, modes: HydraulicModes) -> mujoco.MjModel:
    """The model with cameras that keep a swinging machine in the picture."""
    model = copy.copy(plant.model)
    model.cam_fovy *= _WIDER
    model.cam_pos[:, 2] -= 0.5 * modes.pose[2]  # half way with the platform, whose z is down
    return model


def _pictures(
    model: mujoco.MjModel,
    swings: Sequence[Swing],
    time: NDArray[np.float64],
    title: str,
    chosen: SwingSettings,
) -> Iterator[NDArray[np.uint8]]:
    letters = max(chosen.width // 24, 10)
    captions = [_lettered(chosen.width, letters, swing.caption) for swing in swings]
    with Stage(model, chosen.width, chosen.height, chosen.camera) as stage:
        for row, now in enumerate(time):
            panels = [
                np.vstack([caption, stage.picture(swing.qpos[row])])
                for caption, swing in zip(captions, swings, strict=True)
            ]
            head = _lettered(COLUMNS * chosen.width, letters + 2, title, f"{now:.3f} s")
            lines = [panels[i : i + COLUMNS] for i in range(0, len(panels), COLUMNS)]
            yield np.vstack([head, *(np.hstack(line) for line in lines)])


def _lettered(width: int, letters: int, left: str, right: str = "") -> NDArray[np.uint8]:
    """Text on white, an even number of pixels high."""
    edge, lines = letters // 2, left.count("\n") + 1
    height = 2 * ((lines * (letters + edge // 2) + 2 * edge) // 2)
    image = Image.new("RGB", (width, height), "white")
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(size=letters)
    draw.multiline_text((edge, edge // 2), left, fill=_INK, font=font, spacing=edge // 2)
    draw.text((width - edge, edge // 2), right, fill=_INK, font=font, anchor="ra")
    return np.asarray(image)
