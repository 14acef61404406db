"""Films as a page: the machine as geometry, its configurations as numbers, and traces in step.

The page is `player.html` with three.js inlined; it moves the machine by the forward kinematics of
its joints, so that what is played is the record's `generalised_position` itself.
"""

import base64
import html
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from matplotlib.colors import to_hex
from numpy.typing import NDArray

from cmf_mj.core.errors import InputError
from cmf_mj.core.files import whole_file
from cmf_mj.show.look import Panel
from cmf_mj.show.stage import Panels, Reel, limits_of, samples_within

SAMPLES_A_SECOND = 128.0  #: Of time on the page at real speed, at most; it draws lines between.

MOST_BYTES = 3_000_000  #: Size of a page, at most.

_SAMPLED = 2_000_000
"""Of it for configurations and traces [bytes]; longer runs have fewer samples a second."""


def write_page(
    reels: Sequence[Reel], span: tuple[float, float], path: Path, speed: float, camera: str
) -> Path:
    """Write reels side by side, within a span of time [s], as one HTML file below 3 MB.

    Raises `InputError` for a model whose geometry alone is larger.
    """
    curves = sum(len(panel.curves) for reel in reels for panel in reel.traces)
    a_sample = 16 / 3 * (curves + sum(reel.model.nq for reel in reels))
    most = min(SAMPLES_A_SECOND / min(speed, 1.0), _SAMPLED / a_sample / (span[1] - span[0]))
    count = max(int((span[1] - span[0]) * most) + 1, 2)
    time = np.linspace(*span, count)
    models: list[dict[str, Any]] = []
    runs = []
    for reel in reels:
        if (model := _model(reel.model)) not in models:
            models.append(model)
        rows = np.searchsorted(reel.time, time + 1e-9, side="right") - 1
        panels = _panels(reel.traces, [other.traces for other in reels], span, time)
        run = {"title": reel.title, "model": models.index(model), "panels": panels}
        runs.append(run | {"qpos": _encoded(reel.qpos[np.maximum(rows, 0)])})
    shown: dict[str, Any] = {"start": span[0], "rate": (count - 1) / (span[1] - span[0])}
    shown |= {"count": count, "speed": speed, "digits": 2 + (speed < 0.1), "columns": len(reels)}
    shown |= {"models": models, "cameras": _cameras(reels[0].model), "camera": camera}
    place = Path(__file__).parent
    parts = {
        "title": html.escape(" | ".join(reel.title.replace("\n", ", ") for reel in reels)),
        "words": _words(reels, span),
        "three": (place / "three.min.js").read_text(encoding="utf-8"),
        "data": json.dumps({**shown, "runs": runs}).replace("<", "\\u003c"),
    }
    page = (place / "player.html").read_text(encoding="utf-8")
    for name, text in parts.items():
        page = page.replace(f"{{{{{name}}}}}", text)
    if len(page.encode()) > MOST_BYTES:
        text = f"{len(page.encode()) / 1e6:.1f} MB must be at most {MOST_BYTES / 1e6:g} MB"
        raise InputError(f"file: {path.name} with {text}; film it as .mp4")
    with whole_file(path) as partial:
        partial.write_text(page, encoding="utf-8")
    return path


def _encoded(values: NDArray[np.floating]) -> str:
    """Single precision, little-endian, as base64."""
    return base64.b64encode(np.ascontiguousarray(values, "<f4").tobytes()).decode()


def _model(model: mujoco.MjModel) -> dict[str, Any]:
    """Bodies with joints and geoms, in MuJoCo's frames; lengths in m, quaternions w first."""
    bodies: list[dict[str, Any]] = [
        {
            "parent": int(model.body_parentid[i]) if i else -1,
            "pos": model.body_pos[i].tolist(),
            "quat": model.body_quat[i].tolist(),
            "joints": [],
            "geoms": [],
        }
        for i in range(model.nbody)
    ]
    for i in range(model.njnt):
        at = int(model.jnt_qposadr[i])
        joint = {"type": mujoco.mjtJoint(model.jnt_type[i]).name[6:].lower(), "at": at}
        joint |= {"axis": model.jnt_axis[i].tolist(), "pos": model.jnt_pos[i].tolist()}
        bodies[model.jnt_bodyid[i]]["joints"].append({**joint, "zero": float(model.qpos0[at])})
    for i in np.flatnonzero(model.geom_group <= 2).tolist():
        form = mujoco.mjtGeom(model.geom_type[i]).name[7:].lower()
        material = model.geom_matid[i]
        colour = model.geom_rgba[i] if material < 0 else model.mat_rgba[material]
        size, middle, turn = model.geom_size[i], model.geom_pos[i], model.geom_quat[i]
        if form == "mesh":  # drawn as the box around it
            form, size = "box", model.geom_aabb[i, 3:]
        geom = {"type": form, "size": np.round(size, 4).tolist(), "quat": turn.round(6).tolist()}
        geom |= {"pos": np.round(middle, 4).tolist(), "rgb": colour[:3].round(3).tolist()}
        bodies[model.geom_bodyid[i]]["geoms"].append(geom)
    return {"nq": model.nq, "extent": float(model.stat.extent), "bodies": bodies}


def _cameras(model: mujoco.MjModel) -> dict[str, Any]:
    """Fixed cameras, each with how far ahead of it the middle of the machine is [m]."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    found = {}
    for i in range(model.ncam):
        ahead = -data.cam_xmat[i].reshape(3, 3)[:, 2]
        found[model.camera(i).name] = {
            "pos": data.cam_xpos[i].tolist(),
            "forward": ahead.tolist(),
            "distance": float(ahead @ (model.stat.center - data.cam_xpos[i])),
            "fovy": float(model.cam_fovy[i]),
        }
    return found


def _panels(
    panels: Panels, every: Sequence[Panels], span: tuple[float, float], time: NDArray[np.float64]
) -> list[dict[str, Any]]:
    """Panels whose axes take in those of every run, with all curves at the same times."""
    shown = []
    for panel, *others in zip(panels, *every, strict=True):
        low, high = limits_of(others, span)
        lines = [
            {"name": curve.name, "colour": to_hex(curve.colour), "width": curve.width}
            | {"y": _encoded(np.interp(time, curve.x, curve.y))}
            for curve in panel.curves
        ]
        one = {"title": panel.y_title, "limits": [low, high], "curves": lines}
        shown.append(one | {"digits": digits_of(high - low)})
    return shown


def digits_of(range_: float) -> int:
    """Decimals that show a hundredth of a range, none of one above 100."""
    return 0 if range_ > 100.0 else max(2 - math.floor(math.log10(max(range_, 1e-9))), 2)


def _said(panel: Panel, span: tuple[float, float]) -> str:
    """How far a response goes after a step, where it ends and how it swings; else nothing."""
    demand, *rest = panel.curves
    x, asked = samples_within(demand, span)
    step = asked[-1] - asked[0]
    if demand.name != "demand" or np.unique(asked).size != 2 or step == 0.0:
        return ""
    y = (samples_within(rest[0], span)[1] - asked[0]) / step
    off, inner = y - y[-1], y[1:-1]
    tops = 1 + np.flatnonzero((inner > y[:-2]) & (inner >= y[2:]) & (off[1:-1] > 0.02))
    text = f"{panel.y_title}: {rest[0].name} goes to {y.max():.2f} of the step, ends at {y[-1]:.2f}"
    if (swings := tops.size - 1) > 0:
        left = (off[tops[-1]] / off[tops[0]]) ** (1 / swings)
        text += f", swings {swings / (x[tops[-1]] - x[tops[0]]):.1f} times a second"
        text += f", each swing {left:.0%} of the last"
    return f'<tr><td colspan="5">{html.escape(text)}.'


def _words(reels: Sequence[Reel], span: tuple[float, float]) -> str:
    """Each curve in a row: where it begins and ends, its lowest and highest value and when."""
    rows = []
    for reel in reels:
        rows.append(f'<tr><th colspan="5" scope="rowgroup">{html.escape(reel.title)}</th></tr>')
        for panel in reel.traces:
            digits = digits_of(np.ptp(limits_of([panel], span)))
            rows.append(_said(panel, span))
            for curve in panel.curves:
                x, y = samples_within(curve, span)
                ends = 0, y.argmin(), y.argmax(), -1
                cells = [f"{y[i].round(digits) + 0.0:.{digits}f}" for i in ends]
                for cell in (1, 2):
                    cells[cell] += f" at {x[ends[cell]]:.2f} s"
                cells.insert(0, html.escape(f"{panel.y_title}: {curve.name}"))
                rows.append("<tr><td>" + "</td><td>".join(cells))
    names = ("", "first", "lowest", "highest", "last")
    heads = "".join(f'<th scope="col">{name}</th>' for name in names)
    said = f"{len(reels)} {'runs' if len(reels) > 1 else 'run'}, from {span[0]:g} to {span[1]:g} s."
    return f"<p>{said}</p><table><tr>{heads}</tr>{''.join(rows)}</table>"
