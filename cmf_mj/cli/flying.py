"""`cmf flight` and `cmf fly`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from cmf_mj.cli.common import (
    TEXT_WIDTH,
    Cab,
    Camera,
    Dof,
    Fps,
    Height,
    HydraulicSet,
    Noise,
    Seconds,
    Speed,
    Start,
    StripHeight,
    Width,
    app,
    names_of,
    noise_choice,
    progress_bar,
    refuse,
    show,
)
from cmf_mj.control.law import load_law
from cmf_mj.facility.operation import FacilitySettings
from cmf_mj.pilot.aircraft.flight import flight_names, load_flight
from cmf_mj.pilot.aircraft.recorder import ScriptedFlight
from cmf_mj.pilot.aircraft.scripts import SCRIPTS
from cmf_mj.pilot.fly import fly
from cmf_mj.pilot.transport import transport_delay
from cmf_mj.plant.hexapod import hexapod_spec
from cmf_mj.show import flight as flight_report
from cmf_mj.show.film.film import FilmSettings, check_film, film
from cmf_mj.show.operation import save_operation


@app.command("flight")
def flight_command(
    name: Annotated[str, typer.Argument(help=f"script: {', '.join(SCRIPTS)}")],
    out: Annotated[Path, typer.Option(help="CSV or Parquet file")],
    aircraft: Annotated[str, typer.Option(help="of JSBSim")] = "737",
    seed: Annotated[int, typer.Option(help="of the turbulence")] = 1,
    single: Annotated[bool, typer.Option(help="round to single precision")] = False,
) -> None:
    """Fly a script with JSBSim and record what the pilot's station is subjected to."""
    try:
        flight = ScriptedFlight(name, aircraft=aircraft, seed=seed).record()
        path = flight.save(out, single=single)
        x, y, z = flight.origin.lever_arm
        show(
            f"{flight.origin.title}: {flight.motion.time.size} samples at 80 Hz",
            f"pilot's station from the centre of gravity: {x:.2f} m forward, {y:.2f} right, "
            f"{z:.2f} down",
            f"written: {path}",
        )
    except (ValueError, OSError, ModuleNotFoundError) as error:
        refuse(error)


@app.command("fly")
def fly_command(
    flight: Annotated[str, typer.Argument(help=f"{', '.join(flight_names())}, or a file")],
    law: Annotated[
        str, typer.Option(help="laws by name or TOML file, comma-separated")
    ] = "velocity",
    cab: Cab = "gfd",
    cueing: Annotated[
        str, typer.Option(help="classical, optimal, another washout by name, or a TOML file")
    ] = "classical",
    hydraulics: HydraulicSet = "hardware",
    noise: Noise = True,
    delay: Annotated[bool, typer.Option(help="measure the delay from host to pilot too")] = True,
    dof: Dof = "heave",
    video: Annotated[
        bool, typer.Option("--video", help="film it too, laws side by side: video.mp4")
    ] = False,
    start: Start = 0.0,
    seconds: Seconds = None,
    fps: Fps = 30,
    speed: Speed = 1.0,
    camera: Camera = "overview",
    width: Width = 720,
    height: Height = 450,
    strip: StripHeight = 300,
    out: Annotated[Path, typer.Option(help="folder for results")] = Path("out/fly"),
) -> None:
    """Fly an aircraft in the cab, once for each law, and compare what the pilot feels."""
    try:
        laws = [load_law(name) for name in names_of(law, ())]
        flown = load_flight(flight)
        look = FilmSettings(fps, speed, camera, width, height, strip, None, start, seconds)
        filmed = out / "video.mp4"
        if video:
            check_film(hexapod_spec(cab).compile(), filmed, look)
        facility = FacilitySettings(electronics=noise_choice(noise))
        washout = "simona" if cueing == "classical" else cueing
        columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
        rides, paths = [], []
        with Progress(*columns, console=Console(stderr=True)) as bar:
            for chosen in laws:
                length = float(flown.motion.time[-1])
                task = bar.add_task(f"{chosen.name}: compiling and flying", total=length)
                ride = fly(
                    flown,
                    chosen,
                    cab=cab,
                    cueing=washout,
                    hydraulics=hydraulics,
                    facility=facility,
                    progress=lambda done, task=task: bar.update(task, completed=done),  # type: ignore[misc]
                )
                rides.append(ride)
                paths += save_operation(ride.operation, out / ride.law)
                paths += flight_report.save_ride(ride, out / ride.law)
        paths += flight_report.save_comparison(rides, out)
        if video:
            with progress_bar() as update:
                records = [ride.operation.record for ride in rides]
                titles = [f"{ride.law}, {ride.cab}" for ride in rides]
                traces = [flight_report.flight_traces(ride) for ride in rides]
                film(records, filmed, look, titles=titles, traces=traces, progress=update)
            paths.append(filmed)
        table = flight_report.comparison_table(rides)
        show(flown.origin.title, table, width=Console(width=1000).measure(table).maximum)
        if delay:
            measured = transport_delay(
                laws[0], cab=cab, dof=dof, hydraulics=hydraulics, facility=facility
            )
            show(flight_report.delay_table(measured))
        for ride in rides:
            kept = "kept within" if ride.use.within else "LEFT"
            show(
                f"{ride.law}: {kept} the envelope, legs {ride.use.leg_position:.0%} of their "
                f"stroke, {ride.use.leg_velocity:.0%} of their speed, {int(ride.held.sum())} "
                f"host frames held back; host to legs "
                f"{1e3 * (ride.host_delay + ride.loop_delay):.0f} ms"
            )
        show(f"written to {out}: {len(paths)} files", width=TEXT_WIDTH)
    except (ValueError, OSError, FloatingPointError) as error:
        refuse(error)
