"""The files of a scenario's run."""

from collections.abc import Callable
from pathlib import Path

from cmf_mj.facility.scenario.settings import Scenario, save_scenario
from cmf_mj.record.record import Record
from cmf_mj.show.film.film import FilmSettings, film
from cmf_mj.show.look import save_figure
from cmf_mj.show.overview import overview_figure


def save_run(
    record: Record,
    scenario: Scenario,
    folder: Path,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> list[Path]:
    """Write what a scenario asks for under `outputs`, and the scenario itself.

    The scenario goes to `scenario.toml`, with absolute names of the files in it.
    """
    outputs, paths = scenario.outputs, [save_scenario(scenario, folder / "scenario.toml")]
    if outputs.record:
        paths.append(record.save(folder / outputs.record))
    if outputs.plot:
        changes = [change.when(scenario.rate) / scenario.rate for change in scenario.change]
        events = [event.at for event in scenario.event]
        figure = overview_figure(record, scenario.title, changes, events)
        paths.append(save_figure(figure, folder / outputs.plot))
    if outputs.video is not None:
        video = outputs.video
        settings = FilmSettings(fps=video.fps, speed=video.speed, camera=video.camera)
        paths.append(film([record], folder / video.file, settings, progress=progress))
    return paths
