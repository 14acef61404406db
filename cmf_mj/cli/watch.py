"""Watch a simulation: `cmf video` and `studio`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option

from cmf_mj.cli import options
from cmf_mj.cli.common import app, changed_scenario, progress_bar, show
from cmf_mj.cli.options import argument, choice, new_file
from cmf_mj.core.errors import InputError, require

if TYPE_CHECKING:
    pass

command = partial(app.command, rich_help_panel="Simulate")


@command("video")
def video_command(
    scenario: Annotated[
        list[str] | None,
        argument(
            options.SCENARIOS,
            "[SCENARIO]...",
            "scenarios by name or TOML file, or Parquet records",
            free=True,
        ),
    ] = None,
    laws: Annotated[
        list[str] | None, choice(options.LAWS, "LAWS", "laws next to each other", free=True)
    ] = None,
    machine: options.OtherMachine = None,
    cab: options.OtherCab = None,
    file: Annotated[Path, new_file(help="MP4 or GIF file")] = Path("out/video.mp4"),
    fps: options.Fps = 30,
    speed: options.Speed = 1.0,
    camera: options.Camera = "overview",
    width: options.Width = 720,
    height: options.Height = 450,
    start: options.Start = 0.0,
    seconds: options.Seconds = None,
) -> None:
    """Render a run, or several side by side, to MP4 or GIF, with live traces; needs no display."""
    from cmf_mj.facility.scenario import load_scenario, run_scenario
    from cmf_mj.record.record import Record
    from cmf_mj.show.film.film import FilmSettings, film

    sources = scenario or ["heave_sine"]
    if len(sources) > 1 and laws:
        raise InputError("laws: are for one scenario; give one, or no laws")
    records, titles = [], []
    with progress_bar() as progress:
        for source in sources:
            if source.endswith(".parquet"):
                records.append(Record.load(source))
                titles.append(f"{Path(source).stem}: {records[-1].metadata['law']}")
                continue
            base = load_scenario(source)
            for law in laws or [str(base.law)]:
                one = changed_scenario(base, law=law, machine=machine, cab=cab)
                records.append(run_scenario(one, progress=progress))
                titles.append(one.law if laws else one.title or Path(source).stem)
    settings = FilmSettings(fps, speed, camera, width, height, start=start, seconds=seconds)
    with progress_bar("drawing") as progress:
        path = film(records, file, settings, titles=titles, progress=progress)
    show(f"written: {path}")


@command("studio")
def studio_command(
    scenario: options.Scenario = "",
    host: Annotated[str, Option(help="address to listen on")] = "127.0.0.1",
    port: Annotated[int, Option(help="TCP port; the next free one if it is taken")] = 8048,
    browse: Annotated[
        bool, Option("--open/--no-open", help="whether to open the page in a browser")
    ] = True,
) -> None:
    """Drive the machine in a web page, in real time."""
    import signal
    import time
    import warnings
    import webbrowser

    from cmf_mj.facility.scenario import load_scenario

    for package in ("viser", "mjviser"):
        require(package, "studio")
    from cmf_mj.show.studio.server import Studio

    # A picture on its way to a tab that has just been closed is nothing to tell of.
    warnings.filterwarnings("ignore", message="Queued a .* on a closed connection")
    studio = Studio(host, port, load_scenario(scenario) if scenario else None)
    try:
        # A shell that starts it in the background would have it ignore Ctrl-C for good.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.default_int_handler)
        print(f"studio: {studio.url} (end with Ctrl-C)", flush=True)
        if browse:
            webbrowser.open(studio.url)
        while True:
            time.sleep(1.0)
    except KeyboardInterrupt:
        pass
    finally:
        studio.stop()
