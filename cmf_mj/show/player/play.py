"""Runs side by side on a page that plays them, with traces in step."""

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from cmf_mj.core.errors import InputError, check_name
from cmf_mj.machine import models
from cmf_mj.machine.cab import recorded_cab
from cmf_mj.plant.hexapod import hexapod_model
from cmf_mj.record.record import Record
from cmf_mj.show.player.page import PlayedRun, write_page
from cmf_mj.show.player.traces import Panels, busiest_leg, traces_of


def play(
    records: Sequence[Record],
    path: str | Path,
    *,
    titles: Sequence[str] = (),
    traces: Sequence[Panels] = (),
    speed: float = 1.0,
    camera: str = "overview",
    start: float = 0.0,
    seconds: float | None = None,
) -> Path:
    """Write an HTML page that plays runs in three dimensions, to orbit in any browser.

    The page appears only when it is complete; a shorter run rests at its end next to a longer one.

    Args:
        records: of a hexapod or of single legs.
        path: of the page, ending in `.html`.
        titles: of the runs; default the names of their laws.
        traces: under each run; default `traces_of` the record.
        speed: times real speed.
        camera: of the model, from which the page first shows it.
        start: time of the runs at which the page begins [s].
        seconds: time of the runs that it shows [s]; default to the end of the longest.

    Raises:
        InputError: for an argument out of range.
    """
    target = Path(path)
    if not records:
        raise InputError("records: none is given; give at least one")
    if target.suffix != ".html":
        raise InputError(f"file: {target.name} must end in .html")
    if not (np.isfinite(speed) and speed > 0.0):
        raise InputError(f"speed: {speed} must be greater than 0")
    if seconds is not None and not seconds > 0.0:
        raise InputError(f"seconds: {seconds} must be greater than 0")
    end = max(float(record.time[-1]) for record in records)
    if not 0.0 <= start < end:
        raise InputError(f"start: {start} s; allowed: from 0 to below {end:g} s")
    if seconds is not None:
        end = min(end, start + seconds)
    shown_traces = traces or [traces_of(record, busiest_leg(*records)) for record in records]
    if len({len(panels) for panels in shown_traces}) > 1:
        counts = [len(panels) for panels in shown_traces]
        raise InputError(f"traces: {counts} panels; allowed: as many of each record")
    shown_titles = titles or [str(record.metadata["law"]) for record in records]
    runs = [
        PlayedRun(model_of(record), record.time, record["generalised_position"], title, panels)
        for record, title, panels in zip(records, shown_titles, shown_traces, strict=True)
    ]
    model = runs[0].model
    check_name("camera", camera, [model.camera(i).name for i in range(model.ncam)])
    return write_page(runs, (start, end), target, speed, camera)


def model_of(record: Record) -> mujoco.MjModel:
    """The MuJoCo model that a record's `generalised_position` belongs to."""
    plant = record.metadata.get("plant")
    if plant == "hexapod":
        return hexapod_model(recorded_cab(record.metadata) or "gfd")
    if plant == "single_legs":
        return mujoco.MjModel.from_xml_path(str(models.model_path("single_legs.xml")))
    raise InputError(f"plant: {plant!r} of the record is not one of hexapod, single_legs")
