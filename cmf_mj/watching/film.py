"""Films of one run, or of two side by side, with live traces under the picture."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from cmf_mj import models
from cmf_mj.plant.hexapod import hexapod_spec
from cmf_mj.record import Record
from cmf_mj.watching.encoding import check_film, write_film
from cmf_mj.watching.stage import Stage
from cmf_mj.watching.strip import Strip, traces_of


class FilmSettings(NamedTuple):
    """How a film looks."""

    fps: int = 30
    """Pictures a second."""
    speed: float = 1.0
    """Times real speed."""
    camera: str = "overview"
    """Camera of the model."""
    width: int = 720
    """Of the picture of one run [pixels], even."""
    height: int = 450
    """[pixels], even."""
    strip: int = 190
    """Height of the traces [pixels], even; 0 for none."""
    dof: str | None = None
    """Degree of freedom in the traces; default the one that moves most."""


def film(
    records: Sequence[Record],
    path: str | Path,
    settings: FilmSettings | None = None,
    *,
    titles: Sequence[str] = (),
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Render runs to an MP4 or GIF file, by the name's end; it appears only when it is complete.

    A film of t seconds of a run has t / speed x fps pictures, each of the last row before its time;
    a shorter run rests at its end beside a longer one.

    Args:
        records: one run, or several side by side.
        path: ends in .mp4 or .gif.
        settings: how it looks.
        titles: over each run; default its law.
        progress: called with the pictures done and those in all.

    Raises:
        ValueError: an argument out of range or a missing package, named.
    """
    chosen, target = settings or FilmSettings(), Path(path)
    sizes = {"width": chosen.width, "height": chosen.height, "strip": chosen.strip}
    check_film(target, chosen.fps, chosen.speed, sizes)
    if not records:
        raise ValueError("records: none is given; give at least one")
    named = list(titles) or [str(record.metadata["law"]) for record in records]
    length = max(float(record.time[-1]) for record in records)
    count = int(length / chosen.speed * chosen.fps) + 1
    pictures = _pictures(records, named, count, chosen)
    return write_film(pictures, count, target, chosen.fps, progress=progress)


def model_of(record: Record) -> mujoco.MjModel:
    """The MuJoCo model that a record's `generalised_position` belongs to.

    Raises:
        ValueError: the record is not of one of the project's two plants.
    """
    plant = record.metadata.get("plant")
    if plant == "hexapod":
        return hexapod_spec(str(record.metadata["cab"])).compile()
    if plant == "single_legs":
        return mujoco.MjModel.from_xml_path(str(models.single_legs_path()))
    raise ValueError(f"plant: {plant!r} of the record is not one of hexapod, single_legs")


def _pictures(
    records: Sequence[Record], titles: Sequence[str], count: int, chosen: FilmSettings
) -> Iterator[NDArray[np.uint8]]:
    traces = [traces_of(record, chosen.dof) for record in records]
    with ExitStack() as stack:
        stages = [
            stack.enter_context(Stage(model_of(r), chosen.width, chosen.height, chosen.camera))
            for r in records
        ]
        strips = [Strip(t, chosen.width, chosen.strip, traces) for t in traces if chosen.strip]
        for number in range(count):
            time = number * chosen.speed / chosen.fps
            columns = []
            for index, (record, stage) in enumerate(zip(records, stages, strict=True)):
                row = int(np.searchsorted(record.time, time + 1e-9, side="right")) - 1
                scene = _titled(
                    stage.picture(record["generalised_position"][row]), titles[index], time
                )
                parts = [scene, *(strip.picture(time) for strip in strips[index : index + 1])]
                columns.append(np.vstack(parts))
            yield np.hstack(columns)


def _titled(scene: NDArray[np.uint8], title: str, time: float) -> NDArray[np.uint8]:
    image = Image.fromarray(scene)
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(size=max(scene.shape[0] // 24, 11))
    edge = scene.shape[0] // 40
    for place, text, anchor in (
        ((edge, edge), title, "lt"),
        ((scene.shape[1] - edge, edge), f"{time:.2f} s", "rt"),
    ):
        draw.text(
            place, text, fill="white", font=font, anchor=anchor, stroke_width=1, stroke_fill="#223"
        )
    return np.asarray(image)
