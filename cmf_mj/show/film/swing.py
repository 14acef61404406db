"""A film of the hydraulic modes: the machine swinging in all six at one rate, exaggerated."""

import copy
from collections.abc import Callable
from pathlib import Path

import numpy as np

from cmf_mj.analysis.modes import largest_stroke, swinging
from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.machine.geometry import DOFS
from cmf_mj.plant.hexapod import Hexapod, HydraulicModes
from cmf_mj.show.film.film import FilmSettings, Reel, check_settings, write_reels
from cmf_mj.show.modes import title_of

LEAST_PICTURES = 4
"""Pictures in a period of the fastest mode, at least."""


def swing_film(
    plant: Hexapod,
    modes: HydraulicModes,
    path: str | Path,
    settings: FilmSettings,
    *,
    stroke: float = 12.0 * units.INCH,
    periods: float = 1.0,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Render the modes at a pose, for `periods` of the lowest, to an MP4 or GIF file.

    In each mode the legs swing by `stroke` [m] or by what their working stroke leaves.
    """
    check_settings(path, settings)
    if not (np.isfinite(periods) and periods > 0.0):
        raise InputError(f"periods: {periods} of the lowest mode must be greater than 0")
    most_stroke = plant.machine.working_stroke
    if not 0.0 < stroke <= most_stroke:
        text = f"must be greater than 0 and at most {most_stroke:.4f} m"
        raise InputError(f"stroke: {stroke:.4f} m {text}")
    lowest, fastest = float(modes.frequency_hz[0]), float(modes.frequency_hz[-1])
    most = settings.fps / (LEAST_PICTURES * fastest)
    if settings.speed > most:
        raise InputError(
            f"speed: {settings.speed} with {settings.fps} pictures a second leaves mode 6 at "
            f"{fastest:.1f} Hz fewer than {LEAST_PICTURES} a period; must be at most {most:.3g}"
        )
    count = max(round(periods / (lowest * settings.speed) * settings.fps), 1)
    time = np.arange(count) * settings.speed / settings.fps
    model = copy.copy(plant.drawn_model)
    model.cam_fovy *= 1.15  # the swinging machine needs a wider view
    model.cam_pos[:, 2] -= 0.5 * modes.pose[2]  # half way with the platform, whose z is down
    reels = []
    for mode in range(6):
        motion = min(stroke, largest_stroke(plant, modes, mode))
        caption = f"{title_of(modes)}\n{caption_of(modes, mode, motion)}"
        qpos = swinging(plant, modes, mode, time, stroke=motion)
        reels.append(Reel(model, time, qpos, caption))
    return write_reels(reels, count, path, settings, columns=3, progress=progress)


def caption_of(modes: HydraulicModes, mode: int, motion: float) -> str:
    """Frequency, mass that a leg feels; leading share and leg motion [m]."""
    leading = int(modes.share[:, mode].argmax())
    return (
        f"mode {mode + 1}: {modes.frequency_hz[mode]:.2f} Hz, "
        f"{units.from_si('lbm', modes.leg_mass[mode]):.0f} lbm a leg\n"
        f"{DOFS[leading]} {100.0 * modes.share[leading, mode]:.0f} %, "
        f"legs ±{units.from_si('in', motion):.1f} in"
    )
