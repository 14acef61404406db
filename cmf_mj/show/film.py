"""Films of one run, or of several side by side, with live traces."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from cmf_mj.core.errors import InputError, require
from cmf_mj.core.files import whole_file
from cmf_mj.machine import models
from cmf_mj.machine.cab import recorded_cab
from cmf_mj.plant.hexapod import hexapod_model
from cmf_mj.record.record import Record
from cmf_mj.show.player.writer import write_page
from cmf_mj.show.stage import FilmStage, Panels, Reel, Strip, busiest_leg, traces_of

Picture = NDArray[np.uint8]
Progress = Callable[[int, int], None]


class FilmSettings(NamedTuple):
    """How a film looks."""

    fps: int = 30  #: Frame rate [1/s].
    speed: float = 1.0  #: Times real speed.
    camera: str = "overview"  #: Camera of the model.
    width: int = 720  #: Of the picture of one run [pixels], even.
    height: int = 450  #: [pixels], even.
    strip: int = 190  #: Height of the traces [pixels], even; 0 for none.
    start: float = 0.0  #: Time of the runs at which it begins [s].
    seconds: float | None = None
    """Time of the runs that it shows [s]; default to the end of the longest."""


def film(
    records: Sequence[Record],
    path: str | Path,
    settings: FilmSettings | None = None,
    *,
    titles: Sequence[str] = (),
    traces: Sequence[Panels] = (),
    progress: Progress | None = None,
) -> Path:
    """Show runs side by side in an MP4 or HTML file; it appears only when it is complete.

    An HTML file is a page that plays them in three dimensions. A film of t seconds of a run has
    t / speed x fps pictures, each of the last row before its time; a shorter run rests at its end
    next to a longer one. `titles` are the laws and `traces` are `traces_of` the records by default;
    `progress` is called with the pictures done and those in all. Raises `InputError` for an
    argument out of range, `MissingExtraError` without PyAV.
    """
    chosen, target = settings or FilmSettings(), Path(path)
    if not records:
        raise InputError("records: none is given; give at least one")
    _check(target, chosen)
    end = max(float(record.time[-1]) for record in records)
    if not 0.0 <= chosen.start < end:
        raise InputError(f"start: {chosen.start} s; allowed: from 0 to below {end:g} s")
    if chosen.seconds is not None:
        end = min(end, chosen.start + chosen.seconds)
    named = titles or [str(record.metadata["law"]) for record in records]
    every = traces or [traces_of(record, leg=busiest_leg(*records)) for record in records]
    if len({len(panels) for panels in every}) > 1:
        raise InputError(f"traces: {[*map(len, every)]} panels; allowed: as many of each record")
    reels = [
        Reel(model_of(record), record.time, record["generalised_position"], title, panels)
        for record, title, panels in zip(records, named, every, strict=True)
    ]
    count = int((end - chosen.start) / chosen.speed * chosen.fps) + 1
    if target.suffix == ".html":
        last = chosen.start + max(count - 1, 1) * chosen.speed / chosen.fps
        write_page(reels, (chosen.start, last), target, chosen.speed, chosen.camera)
        if progress is not None:
            progress(count, count)
        return target
    with whole_file(target) as partial:
        pictures = _pictures(reels, count, chosen)
        for number, _ in enumerate(_mp4(pictures, partial, chosen.fps), start=1):
            if progress is not None:
                progress(number, count)
    return target


def _check(target: Path, settings: FilmSettings) -> None:
    """Refuse a file name or settings that no film can have."""
    fps, speed = settings.fps, settings.speed
    if target.suffix not in (".mp4", ".html"):
        raise InputError(f"out: {target.name} must end in .mp4 or .html")
    if not (np.isfinite(speed) and speed > 0.0) or fps < 1:
        raise InputError(f"speed, fps: {speed}, {fps} must be greater than 0")
    for name in ("width", "height", "strip"):
        if getattr(settings, name) % 2:
            raise InputError(f"{name}: {getattr(settings, name)} pixels must be even")
    if settings.seconds is not None and not settings.seconds > 0.0:
        raise InputError(f"seconds: {settings.seconds} must be greater than 0")


def model_of(record: Record) -> mujoco.MjModel:
    """The MuJoCo model that a record's `generalised_position` belongs to."""
    plant = record.metadata.get("plant")
    if plant == "hexapod":
        return hexapod_model(recorded_cab(record.metadata) or "gfd")
    if plant == "single_legs":
        return mujoco.MjModel.from_xml_path(str(models.model_path("single_legs.xml")))
    raise InputError(f"plant: {plant!r} of the record is not one of hexapod, single_legs")


def _pictures(reels: Sequence[Reel], count: int, chosen: FilmSettings) -> Iterator[Picture]:
    times = chosen.start + np.arange(count) * chosen.speed / chosen.fps
    with ExitStack() as stack:
        stages: dict[mujoco.MjModel, FilmStage] = {}
        for reel in reels:
            if reel.model not in stages:
                stage = FilmStage(reel.model, chosen.width, chosen.height, chosen.camera)
                stages[reel.model] = stack.enter_context(stage)
        every = [reel.traces for reel in reels if reel.traces and chosen.strip]
        span = chosen.start, chosen.start + count * chosen.speed / chosen.fps
        strips = [Strip(panels, chosen.width, chosen.strip, span, every) for panels in every]
        for time in times:
            clock = f"{time:.{2 if chosen.speed > 0.1 else 3}f} s"
            parts = []
            for reel in reels:
                row = int(np.searchsorted(reel.time, time + 1e-9, side="right")) - 1
                scene = stages[reel.model].picture(reel.qpos[row])
                parts.append(_titled(scene, reel.title, clock))
            for index, strip in enumerate(strips):
                parts[index] = np.vstack([parts[index], strip.picture(time)])
            yield np.hstack(parts)


def _titled(scene: Picture, *texts: str) -> Picture:
    """A picture with text in its upper corners."""
    image = Image.fromarray(scene)
    edge, font = scene.shape[0] // 40, ImageFont.load_default(size=max(scene.shape[0] // 24, 11))
    style: dict[str, Any] = {"fill": "white", "stroke_width": 1, "stroke_fill": "#223"}
    for x, text, anchor in zip((edge, scene.shape[1] - edge), texts, ("la", "ra"), strict=True):
        ImageDraw.Draw(image).text((x, edge), text, font=font, anchor=anchor, **style)
    return np.asarray(image)


def _mp4(pictures: Iterator[Picture], target: Path, fps: int) -> Iterator[None]:
    """Write a file, a picture a turn."""
    av = require("av", "video")
    first = next(pictures)
    with av.open(str(target), "w", format="mp4") as container:
        stream = container.add_stream("h264", rate=Fraction(fps))
        stream.height, stream.width = first.shape[:2]
        stream.pix_fmt = "yuv420p"
        stream.bit_rate = 4_000_000
        for picture in chain([first], pictures):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
            container.mux(stream.encode(frame))
            yield
        container.mux(stream.encode())
