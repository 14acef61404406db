"""Films of one run, or of several side by side, with live traces under the picture."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from cmf_mj.core.errors import InputError
from cmf_mj.machine import models
from cmf_mj.plant.hexapod import hexapod_spec
from cmf_mj.record.record import Record
from cmf_mj.show.film.encoding import check_format, mp4_codec, write_film
from cmf_mj.show.film.stage import Stage
from cmf_mj.show.film.strip import Strip, Traces, traces_of


class FilmSettings(NamedTuple):
    """How a film looks."""

    fps: int = 30  #: Pictures a second.
    speed: float = 1.0  #: Times real speed.
    camera: str = "overview"  #: Camera of the model.
    width: int = 720  #: Of the picture of one run [pixels], even.
    height: int = 450  #: [pixels], even.
    strip: int = 190  #: Height of the traces [pixels], even; 0 for none.
    dof: str | None = None  #: Degree of freedom in the traces; default the one that moves most.
    start: float = 0.0  #: Time of the runs at which it begins [s].
    seconds: float | None = None
    """Time of the runs that it shows [s]; default to the end of the longest."""


def film(
    records: Sequence[Record],
    path: str | Path,
    settings: FilmSettings | None = None,
    *,
    titles: Sequence[str] = (),
    traces: Sequence[Traces] = (),
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Render runs to an MP4 or GIF file, by the name's end; it appears only when it is complete.

    A film of t seconds of a run has t / speed x fps pictures, each of the last row before its time;
    a shorter run rests at its end next to a longer one.

    Args:
        records: one run, or several side by side.
        path: ends in .mp4 or .gif.
        settings: how it looks.
        titles: over each run; default its law.
        traces: under each run; default `traces_of` its record.
        progress: called with the pictures done and those in all.

    Raises:
        InputError: an argument out of range or a missing package, named.
    """
    chosen, target = settings or FilmSettings(), Path(path)
    if not records:
        raise InputError("records: none is given; give at least one")
    _check(target, chosen)
    named = list(titles) or [str(record.metadata["law"]) for record in records]
    end = max(float(record.time[-1]) for record in records)
    if not 0.0 <= chosen.start < end:
        raise InputError(f"start: {chosen.start} s; allowed: from 0 to below {end:g} s")
    if chosen.seconds is not None:
        end = min(end, chosen.start + chosen.seconds)
    count = int((end - chosen.start) / chosen.speed * chosen.fps) + 1
    every = traces or [traces_of(record, chosen.dof) for record in records]
    parts = [one.between(chosen.start, end) for one in every]
    pictures = _pictures(records, named, parts, count, chosen)
    return write_film(pictures, count, target, chosen.fps, progress=progress)


def check_film(model: mujoco.MjModel, path: str | Path, settings: FilmSettings) -> None:
    """Make sure that a film of a model can be made, before a long run for it.

    Raises:
        InputError: what `film` would refuse, named: settings, packages, OpenGL.
    """
    _check(Path(path), settings)
    if Path(path).suffix == ".mp4":
        mp4_codec()
    with Stage(model, settings.width, settings.height, settings.camera):
        pass


def _check(target: Path, settings: FilmSettings) -> None:
    sizes = {"width": settings.width, "height": settings.height, "strip": settings.strip}
    check_format(target, settings.fps, settings.speed, sizes)
    if settings.seconds is not None and not settings.seconds > 0.0:
        raise InputError(f"seconds: {settings.seconds} must be greater than 0")


def model_of(record: Record) -> mujoco.MjModel:
    """The MuJoCo model that a record's `generalised_position` belongs to.

    Raises:
        InputError: the record is not of one of the project's two plants.
    """
    plant = record.metadata.get("plant")
    if plant == "hexapod":
        return hexapod_spec(str(record.metadata["cab"])).compile()
    if plant == "single_legs":
        return mujoco.MjModel.from_xml_path(str(models.model_path("single_legs.xml")))
    raise InputError(f"plant: {plant!r} of the record is not one of hexapod, single_legs")


def _pictures(
    records: Sequence[Record],
    titles: Sequence[str],
    traces: Sequence[Traces],
    count: int,
    chosen: FilmSettings,
) -> Iterator[NDArray[np.uint8]]:
    with ExitStack() as stack:
        stages = [
            stack.enter_context(Stage(model_of(r), chosen.width, chosen.height, chosen.camera))
            for r in records
        ]
        strips = [Strip(t, chosen.width, chosen.strip, traces) for t in traces if chosen.strip]
        for number in range(count):
            time = chosen.start + number * chosen.speed / chosen.fps
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
