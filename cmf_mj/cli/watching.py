"""`cmf view` and `cmf video`."""

from pathlib import Path
from typing import Annotated

import typer

from cmf_mj.cli.common import (
    Camera,
    Fps,
    Height,
    Seconds,
    Speed,
    Start,
    StripHeight,
    Width,
    app,
    names_of,
    progress_bar,
    refuse,
    show,
)
from cmf_mj.core.errors import InputError
from cmf_mj.facility.scenario.library import load_scenario
from cmf_mj.facility.scenario.run import ScenarioRun, run_scenario
from cmf_mj.facility.scenario.settings import Scenario, save_scenario, scenario_of
from cmf_mj.record.record import Record
from cmf_mj.show.film.film import FilmSettings, film
from cmf_mj.show.film.view import LiveView
from cmf_mj.show.film.view import show as show_window

_HEAVE = "heave_sine"

Source = Annotated[str, typer.Argument(help="scenario: TOML file, or a shipped one by name")]
Law = Annotated[str | None, typer.Option("--law", help="law in place of the scenario's")]
Cab = Annotated[str | None, typer.Option(help="gfd, rfd or ifd, in place of the scenario's")]


def _with(scenario: Scenario, **fields: object) -> Scenario:
    """A scenario with other fields, checked anew; None leaves a field."""
    given = {name: value for name, value in fields.items() if value is not None}
    kept = scenario.model_dump(mode="json", exclude_defaults=True, exclude_none=True)
    return scenario_of(kept | given, "options")


@app.command("view")
def view_command(
    scenario: Source = _HEAVE,
    law: Law = None,
    cab: Cab = None,
    speed: Speed = 1.0,
    dof: Annotated[str | None, typer.Option(help="an endless sine along it instead")] = None,
    amplitude: Annotated[str, typer.Option(help="of the sine, with its unit")] = "4 in",
    frequency: Annotated[float, typer.Option(help="of the sine [Hz]")] = 0.3,
    seconds: Annotated[float | None, typer.Option(help="close after this wall time")] = None,
    out: Annotated[Path, typer.Option(help="file that S saves the run to")] = Path(
        "out/view/scenario.toml"
    ),
) -> None:
    """Watch a live closed loop in MuJoCo's viewer and pull it about with the mouse."""
    try:
        sine = None
        if dof is not None:
            number, _, unit = amplitude.partition(" ")
            size = [float(number), unit]
            sine = [{"kind": "sine", "dof": dof, "amplitude": size, "frequency": frequency}]
        chosen = _with(load_scenario(scenario), law=law, cab=cab, signal=sine)
        if sine is not None:
            chosen = _with(chosen, duration="open")

        def save(run: ScenarioRun) -> None:
            show(f"written: {save_scenario(run.scenario(), out)}")

        show_window(LiveView(ScenarioRun(chosen), speed), seconds=seconds, save=save)
    except (ValueError, OSError, FloatingPointError) as error:
        refuse(error)


@app.command("video")
def video_command(
    scenario: Annotated[
        list[str] | None,
        typer.Argument(help="scenarios by name or TOML file, or Parquet records"),
    ] = None,
    laws: Annotated[
        str, typer.Option(help="laws side by side in one scenario, separated by commas")
    ] = "",
    cab: Cab = None,
    out: Annotated[Path, typer.Option(help="MP4 or GIF file")] = Path("out/video.mp4"),
    fps: Fps = 30,
    speed: Speed = 1.0,
    camera: Camera = "overview",
    width: Width = 720,
    height: Height = 450,
    strip: StripHeight = 190,
    dof: Annotated[
        str | None, typer.Option(help="in the traces; default the one that moves most")
    ] = None,
    start: Start = 0.0,
    seconds: Seconds = None,
) -> None:
    """Render a run, or several side by side, to MP4 or GIF, with live traces; needs no display."""
    try:
        sources = scenario or [_HEAVE]
        chosen = names_of(laws, ())
        if len(sources) > 1 and chosen:
            raise InputError("laws: are for one scenario; give one, or no laws")
        records, titles = [], []
        with progress_bar() as progress:
            for source in sources:
                if source.endswith(".parquet"):
                    records.append(Record.load(source))
                    titles.append(f"{Path(source).stem}: {records[-1].metadata['law']}")
                    continue
                found = load_scenario(source)
                for law in chosen or [found.law]:
                    one = _with(found, law=law, cab=cab)
                    records.append(run_scenario(one, progress=progress))
                    titles.append(one.law if chosen else one.title or Path(source).stem)
        settings = FilmSettings(fps, speed, camera, width, height, strip, dof, start, seconds)
        with progress_bar() as progress:
            path = film(records, out, settings, titles=titles, progress=progress)
        show(f"written: {path}")
    except (ValueError, OSError, FloatingPointError) as error:
        refuse(error)
