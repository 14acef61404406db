"""The page that plays runs: geometry of machines, their configurations and traces over time.

The page is `player.html` with three.js inlined; it moves the machine by the forward kinematics of
its joints, so that what is played is the record's `generalised_position` itself.
"""

import base64
import html
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from matplotlib.colors import to_hex
from numpy.typing import NDArray

from cmf_mj.core.errors import InputError
from cmf_mj.core.files import whole_file
from cmf_mj.show.look import Curve, Panel
from cmf_mj.show.player.traces import Panels, limits_of, samples_within

SAMPLES_A_SECOND = 128.0  #: Of time on the page at real speed, at most; it draws lines between.
MOST_BYTES = 3_000_000  #: Size of a page, at most.
_SAMPLE_BYTES = 2_000_000
"""Of the page, for configurations and traces; longer runs have fewer samples a second."""
_SAMPLE_NUMBER_BYTES = 16 / 3  #: Of one number: four bytes, as base64.


class PlayedRun(NamedTuple):
    """One run of a page."""

    model: mujoco.MjModel  #: The machine.
    time: NDArray[np.float64]  #: Of its configurations, rising [s], (n,).
    qpos: NDArray[np.float64]  #: Its configurations, (n, nq).
    title: str  #: Over the picture.
    panels: Panels = ()  #: Traces under the picture.


def write_page(
    runs: Sequence[PlayedRun], span: tuple[float, float], path: Path, speed: float, camera: str
) -> Path:
    """Write runs side by side, within a span of time [s], as one HTML file below 3 MB.

    Raises `InputError` for a page that is larger.
    """
    time = _sample_times(runs, span, speed)
    models, played_runs = list[dict[str, Any]](), list[dict[str, Any]]()
    for run in runs:
        if (geometry := _geometry(run.model)) not in models:
            models.append(geometry)
        rows = np.searchsorted(run.time, time + 1e-9, side="right") - 1
        qpos = run.qpos[np.maximum(rows, 0)]
        panels = _panels(run.panels, [other.panels for other in runs], span, time)
        table = {"title": run.title, "model": models.index(geometry), "panels": panels}
        played_runs.append({**table, "qpos": _encoded(qpos)})
    data = {
        "start": span[0],
        "rate": (time.size - 1) / (span[1] - span[0]),
        "count": time.size,
        "speed": speed,
        "digits": 3 if speed < 0.1 else 2,
        "columns": len(runs),
        "models": models,
        "cameras": _cameras(runs[0].model),
        "camera": camera,
        "runs": played_runs,
    }
    folder = Path(__file__).parent
    parts = {
        "title": html.escape(" | ".join(run.title.replace("\n", ", ") for run in runs)),
        "words": _summary(runs, span),
        "three": (folder / "three.min.js").read_text(encoding="utf-8"),
        "data": json.dumps(data).replace("<", "\\u003c"),
    }
    page = (folder / "player.html").read_text(encoding="utf-8")
    for name, text in parts.items():
        page = page.replace(f"{{{{{name}}}}}", text)
    if (size := len(page.encode())) > MOST_BYTES:
        text = f"{size / 1e6:.1f} MB must be at most {MOST_BYTES / 1e6:g} MB"
        raise InputError(f"file: {path.name} with {text}")
    with whole_file(path) as partial:
        partial.write_text(page, encoding="utf-8")
    return path


def _sample_times(
    runs: Sequence[PlayedRun], span: tuple[float, float], speed: float
) -> NDArray[np.float64]:
    """Times of the samples [s], as many as the page has room for."""
    curves = sum(len(panel.curves) for run in runs for panel in run.panels)
    numbers = curves + sum(run.model.nq for run in runs)
    start, end = span
    largest_count = _SAMPLE_BYTES / (_SAMPLE_NUMBER_BYTES * numbers)
    rate = min(SAMPLES_A_SECOND / min(speed, 1.0), largest_count / (end - start))
    return np.linspace(start, end, max(int((end - start) * rate) + 1, 2))


def _encoded(values: NDArray[np.floating]) -> str:
    """Single precision, little-endian, as base64."""
    return base64.b64encode(np.ascontiguousarray(values, "<f4").tobytes()).decode()


def _geometry(model: mujoco.MjModel) -> dict[str, Any]:
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
        address = int(model.jnt_qposadr[i])
        kind = mujoco.mjtJoint(model.jnt_type[i]).name.removeprefix("mjJNT_").lower()
        joint = {"type": kind, "at": address}
        joint |= {"axis": model.jnt_axis[i].tolist(), "pos": model.jnt_pos[i].tolist()}
        bodies[model.jnt_bodyid[i]]["joints"].append({**joint, "zero": float(model.qpos0[address])})
    for i in np.flatnonzero(model.geom_group <= 2).tolist():
        shape = mujoco.mjtGeom(model.geom_type[i]).name.removeprefix("mjGEOM_").lower()
        material = model.geom_matid[i]
        colour = model.geom_rgba[i] if material < 0 else model.mat_rgba[material]
        size, centre, quaternion = model.geom_size[i], model.geom_pos[i], model.geom_quat[i]
        if shape == "mesh":  # drawn as the box around it
            shape, size = "box", model.geom_aabb[i, 3:]
        geom = {"type": shape, "size": np.round(size, 4).tolist()}
        geom |= {"quat": quaternion.round(6).tolist(), "pos": np.round(centre, 4).tolist()}
        geom |= {"rgb": colour[:3].round(3).tolist()}
        bodies[model.geom_bodyid[i]]["geoms"].append(geom)
    return {"nq": model.nq, "extent": float(model.stat.extent), "bodies": bodies}


def _cameras(model: mujoco.MjModel) -> dict[str, Any]:
    """Fixed cameras, each with how far ahead of it the middle of the machine is [m]."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    cameras = {}
    for i in range(model.ncam):
        forward = -data.cam_xmat[i].reshape(3, 3)[:, 2]
        cameras[model.camera(i).name] = {
            "pos": data.cam_xpos[i].tolist(),
            "forward": forward.tolist(),
            "distance": float(forward @ (model.stat.center - data.cam_xpos[i])),
            "fovy": float(model.cam_fovy[i]),
        }
    return cameras


def _panels(
    panels: Panels,
    all_panels: Sequence[Panels],
    span: tuple[float, float],
    time: NDArray[np.float64],
) -> list[dict[str, Any]]:
    """Panels of a run, whose axes take in those of all runs, with all curves at the same times."""
    tables = []
    for index, panel in enumerate(panels):
        low, high = limits_of([other[index] for other in all_panels], span)
        curves = [
            {
                "name": curve.name,
                "colour": to_hex(curve.colour),
                "width": curve.width,
                "y": _encoded(np.interp(time, curve.x, curve.y)),
            }
            for curve in panel.curves
        ]
        table = {"title": panel.y_title, "limits": [low, high], "curves": curves}
        tables.append({**table, "digits": digits_of(high - low)})
    return tables


def digits_of(range_: float) -> int:
    """Decimals that show a hundredth of a range, none of one above 100."""
    return 0 if range_ > 100.0 else max(2 - math.floor(math.log10(max(range_, 1e-9))), 2)


def _step_text(panel: Panel, span: tuple[float, float]) -> str:
    """How far a response goes after a step, where it ends and how it swings; else nothing."""
    demand, response, *_ = (*panel.curves, None)
    if demand is None or response is None or demand.name != "demand":
        return ""
    _, demanded = samples_within(demand, span)
    start, step = demanded[0], demanded[-1] - demanded[0]
    if np.unique(demanded).size != 2 or step == 0.0:
        return ""
    time, y = samples_within(response, span)
    y = (y - start) / step
    error = y - y[-1]
    rises, falls = y[1:-1] > y[:-2], y[1:-1] >= y[2:]
    tops = 1 + np.flatnonzero(rises & falls & (error[1:-1] > 0.02))
    reach = f"goes to {y.max():.2f} of the step, ends at {y[-1]:.2f}"
    text = f"{panel.y_title}: {response.name} {reach}"
    if (swings := tops.size - 1) > 0:
        first, last = tops[0], tops[-1]
        ratio = (error[last] / error[first]) ** (1 / swings)
        text += f", swings {swings / (time[last] - time[first]):.1f} times a second"
        text += f", each swing {ratio:.0%} of the last"
    return f'<tr><td colspan="5">{html.escape(text)}.'


def _curve_row(panel: Panel, curve: Curve, span: tuple[float, float]) -> str:
    """Where a curve begins and ends, its lowest and highest value and when."""
    digits = digits_of(np.ptp(limits_of([panel], span)))
    time, y = samples_within(curve, span)
    lowest, highest = int(y.argmin()), int(y.argmax())
    first, low, high, last = (
        f"{y[i].round(digits) + 0.0:.{digits}f}" for i in (0, lowest, highest, -1)
    )
    cells = (
        html.escape(f"{panel.y_title}: {curve.name}"),
        first,
        f"{low} at {time[lowest]:.2f} s",
        f"{high} at {time[highest]:.2f} s",
        last,
    )
    return "<tr><td>" + "</td><td>".join(cells)


def _summary(runs: Sequence[PlayedRun], span: tuple[float, float]) -> str:
    """The runs in words: a table with each curve in a row."""
    rows = []
    for run in runs:
        rows.append(f'<tr><th colspan="5" scope="rowgroup">{html.escape(run.title)}</th></tr>')
        for panel in run.panels:
            rows.append(_step_text(panel, span))
            rows += [_curve_row(panel, curve, span) for curve in panel.curves]
    names = ("", "first", "lowest", "highest", "last")
    header_cells = "".join(f'<th scope="col">{name}</th>' for name in names)
    count = f"{len(runs)} {'runs' if len(runs) > 1 else 'run'}"
    text = f"{count}, from {span[0]:g} to {span[1]:g} s."
    return f"<p>{text}</p><table><tr>{header_cells}</tr>{''.join(rows)}</table>"
