"""Flight: `cmf fly`, `learn`, `flight`, `cue run`, `cue tune` and `omct`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from cmf_mj.cli import options
from cmf_mj.cli.common import app, noise_choice, progress_bar, show, written
from cmf_mj.cli.options import argument, choice, file, new_file

if TYPE_CHECKING:
    from cmf_mj.pilot.aircraft.flight import Flight

_PANEL = "Flight"
command = partial(app.command, rich_help_panel=_PANEL)

_FLIGHTS = "pilot.aircraft.flight:flight_names"
_SOURCES = "name or file; with --from a recording, or the UDP port of live telemetry"
_FORMATS, _FORMAT = "pilot.telemetry.formats:FORMATS", "xplane, beamng or csv: telemetry"
From = Annotated[str | None, choice(_FORMATS, "FORMAT", _FORMAT, make=partial(Option, "--from"))]
_KNOWN = 6
"""Drawn machines that a learner is made for; those it is tried on are others."""
_QUICK = (0.631, 2.512, 10.0)
"""Frequencies of a quick test [rad/s]."""


@command("fly")
def fly_command(
    flight: Annotated[str, argument(_FLIGHTS, "FLIGHT", _SOURCES, free=True)],
    form: From = None,
    laws: options.Laws = options.VELOCITY,
    cab: options.Cab = "gfd",
    washout: options.Washout = "simona",
    hydraulics: options.Hydraulics = "hardware",
    noise: options.Noise = True,
    delay: Annotated[bool, Option(help="measure the delay from host to pilot too")] = True,
    dof: options.Dof = "heave",
    video: options.FilmFile = None,
    start: options.Start = 0.0,
    seconds: options.Seconds = None,
    fps: options.Fps = 30,
    speed: options.Speed = 1.0,
    camera: options.Camera = "overview",
    width: options.Width = 720,
    height: options.Height = 450,
    out: options.Out = Path("out/fly"),
) -> None:
    """Fly an aircraft in the cab, once for each law, and compare what the pilot feels."""
    from cmf_mj.control.law import load_law
    from cmf_mj.core.errors import InputError
    from cmf_mj.core.files import in_folder
    from cmf_mj.core.settings import check_distinct
    from cmf_mj.pilot.aircraft.flight import load_flight
    from cmf_mj.pilot.fly import fly, transport_delay
    from cmf_mj.pilot.telemetry.formats import fly_live
    from cmf_mj.plant.hexapod import hexapod_model
    from cmf_mj.show import flight as report
    from cmf_mj.show.film import FilmSettings, check_film, film
    from cmf_mj.show.operation import save_operation

    loaded = [load_law(name) for name in laws]
    check_distinct("laws", [one.name for one in loaded])
    live = form is not None and flight.isascii() and flight.isdigit()
    if live and len(loaded) != 1:
        raise InputError(f"laws: {len(loaded)} for live telemetry; allowed: one")
    flown = None if live else _telemetry(flight, form) if form else load_flight(flight)
    look = FilmSettings(fps, speed, camera, width, height, 300, start, seconds)
    if video is not None:
        pictures = in_folder(out, video)
        check_film(hexapod_model(cab), pictures, look)
    noisy = noise_choice(noise)
    machine: dict[str, Any] = {"cab": cab, "hydraulics": hydraulics, "electronics": noisy}
    length = float(flown.motion.time[-1]) if flown else seconds or 60.0
    rides, paths = [], []
    for law in loaded:
        with progress_bar(f"flying {law.name}", seconds=True) as bar:
            timed = lambda done, bar=bar: bar(done, length)  # noqa: E731
            machine |= {"washout": washout, "progress": timed}
            if flown is None:
                ride = fly_live(str(form), int(flight), law, seconds=length, **machine)
            else:
                ride = fly(flown, law, **machine)
        rides.append(ride)
        folder = in_folder(out, ride.law)
        paths += save_operation(ride.operation, folder)
        paths += report.save_ride(ride, folder)
    paths += report.save_flights(rides, out)
    if video is not None:
        with progress_bar("drawing") as update:
            records = [ride.operation.record for ride in rides]
            titles = [f"{ride.law}, {ride.cab}" for ride in rides]
            traces = [report.flight_traces(ride) for ride in rides]
            film(records, pictures, look, titles=titles, traces=traces, progress=update)
        paths.append(pictures)
    title = flown.origin.title if flown else f"{form} at port {flight}"
    show(title, report.flight_table(rides), unfolded=True)
    if delay:
        of_machine = {name: machine[name] for name in ("cab", "hydraulics", "electronics")}
        show(report.delay_table(transport_delay(loaded[0], dof=dof, **of_machine)))
    for ride in rides:
        kept = "kept within" if ride.use.within else "LEFT"
        show(
            f"{ride.law}: {kept} the envelope, legs {ride.use.leg_position:.0%} of their "
            f"stroke, {ride.use.leg_velocity:.0%} of their speed, {int(ride.limited.sum())} "
            f"host frames held back; host to legs "
            f"{1e3 * (ride.host_delay + ride.loop_delay):.0f} ms"
        )
    show(f"written to {out}: {len(paths)} files")


@command("learn")
def learn_command(
    flight: Annotated[str, argument(_FLIGHTS, "FLIGHT", "name or file", free=True)],
    law: options.Law = "velocity",
    cab: options.Cab = "gfd",
    washout: options.Washout = "simona",
    hydraulics: options.Hydraulics = "hardware",
    noise: options.Noise = True,
    trials: Annotated[int, Option(min=1, help="runs after the first")] = 8,
    on: Annotated[int, Option(help="drawn machines to fly it on", min=0)] = 0,
    seed: options.Seed = 0,
    jobs: options.Jobs = None,
    out: options.Out = Path("out/learn"),
) -> None:
    """Repeat a flight and learn the demand with which the cab follows it."""
    from cmf_mj.pilot.aircraft.flight import load_flight
    from cmf_mj.pilot.cueing.flight import cue
    from cmf_mj.pilot.learning import compare, learn
    from cmf_mj.plant.hexapod import Hexapod
    from cmf_mj.show import flight as report
    from cmf_mj.studies.mismatch import drawn_machine

    asked = cue(load_flight(flight).motion, washout, cab=cab).stream
    machines = [drawn_machine(cab, hydraulics, seed, draw) for draw in range(_KNOWN + on)]  # type: ignore[arg-type]
    plants = [Hexapod(cab, hydraulics), *machines[:_KNOWN]]
    run: dict[str, Any] = {"electronics": noise_choice(noise)}
    with progress_bar(f"learning {flight}") as update:
        run |= {"trials": trials, "seed": seed, "progress": update}
        learnt = learn(asked, law, plants, **run)
    with progress_bar("flying other machines") as update:
        others = compare(
            learnt, machines[_KNOWN:], seed=seed + trials + 1, jobs=jobs, progress=update
        )
    paths = report.save_learning(learnt, others, out)
    show(report.trial_table(learnt), unfolded=True)
    show(report.verdict(learnt, others), written(paths, out))


def _telemetry(source: str, form: str) -> Flight:
    """A recording of telemetry as a flight; what is wrong with it is said, and it is refused."""
    from cmf_mj.core.errors import InputError
    from cmf_mj.pilot.telemetry.check import check
    from cmf_mj.pilot.telemetry.formats import flight_of, read_telemetry

    recorded, refused = read_telemetry(source, form)
    if errors := check(recorded).errors:
        raise InputError(f"{source}: {'; '.join(errors)}")
    if refused:
        show(f"{source}: {refused} datagrams were not of the format {form}")
    return flight_of(recorded, form, Path(source).stem)


telemetry = typer.Typer(no_args_is_help=True, help="Telemetry of other simulators.")
app.add_typer(telemetry, name="telemetry", rich_help_panel=_PANEL)


@telemetry.command("check")
def check_command(
    source: Annotated[str, Argument(metavar="FILE|PORT", help="recording, or UDP port")],
    form: From = "csv",
    seconds: Annotated[float, Option(help="to listen at a port [s]", min=1.0, max=3600.0)] = 20.0,
) -> None:
    """Say what is wrong with telemetry: axes, signs, units, gravity, gaps."""
    from cmf_mj.pilot.telemetry.check import check
    from cmf_mj.pilot.telemetry.formats import listen, read_telemetry

    name = form or "csv"
    if source.isascii() and source.isdigit():
        received, refused = listen(name, int(source), seconds)
    else:
        received, refused = read_telemetry(source, name)
    verdict = check(received)
    span = float(received.time[-1] - received.time[0])
    show(f"{received.time.size} samples in {span:.1f} s, {refused} datagrams of other form")
    show(*(f"ERROR: {error}" for error in verdict.errors))
    show(*(f"these data cannot show whether {doubt}" for doubt in verdict.unseen))
    if verdict.errors:
        raise typer.Exit(1)
    show("no error found")


@command("flight")
def flight_command(
    name: Annotated[str, argument("pilot.aircraft.scripts:SCRIPTS", "SCRIPT", "what to fly")],
    file: Annotated[Path, new_file(help="CSV or Parquet file")],
    aircraft: Annotated[str, Option(help="of JSBSim")] = "737",
    seed: options.Seed = 1,
    single: Annotated[bool, Option("--single", help="round to single precision")] = False,
) -> None:
    """Fly a script with JSBSim and record what the pilot's station is subjected to."""
    from cmf_mj.pilot.aircraft.scripts import ScriptedFlight

    flight = ScriptedFlight(name, aircraft=aircraft, seed=seed).record()
    path = flight.save(file, single=single)
    x, y, z = flight.origin.lever_arm
    show(
        f"{flight.origin.title}: {flight.motion.time.size} samples at 80 Hz",
        f"pilot's station from the centre of gravity: {x:.2f} m forward, {y:.2f} right, "
        f"{z:.2f} down",
        f"written: {path}",
    )


cues = typer.Typer(no_args_is_help=True, help="A flight in the simulator: washout and gains.")
app.add_typer(cues, name="cue", rich_help_panel=_PANEL)

_MOTION = (
    "CSV or Parquet: time, specific_force_x.. [m/s^2], angular_rate_x.. [rad/s], "
    "roll, pitch, yaw [rad] at the pilot's station"
)
Motion = Annotated[Path, Argument(metavar="FLIGHT", help=_MOTION)]
Rate = Annotated[float, Option(min=1.0, max=2048.0, help="host frames a second")]
LimitsFile = Annotated[Path | None, file(help="TOML changes to the machine's limits")]


@cues.command("run")
def run_command(
    flight: Motion,
    washout: options.Washout = "simona",
    cab: options.Cab = "gfd",
    rate: Rate = 80.0,
    limits: LimitsFile = None,
    senses: Annotated[Path | None, file(help="TOML changes to canals, otoliths")] = None,
    out: options.Out = Path("out/cue"),
) -> None:
    """Turn a flight into host frames and report what the pilot senses of it."""
    from cmf_mj.machine.cab import load_cab
    from cmf_mj.machine.motion_limits import load_motion_limits
    from cmf_mj.pilot.cueing.flight import cue
    from cmf_mj.pilot.motion import PilotMotion
    from cmf_mj.show import cueing as report

    motion = PilotMotion.load(flight)
    bounds = load_motion_limits(limits, load_cab(cab).machine)
    thresholds = None if senses is None else str(senses)
    flown = cue(motion, washout, cab=cab, limits=bounds, senses=thresholds, rate=rate)
    paths = report.save_cue(flown, out)
    excursion = report.excursion_table(flown.excursion, int(flown.limited.sum()))
    show(report.error_table(flown), excursion, written(paths))


@cues.command("tune")
def tune_command(
    flight: Motion,
    washout: options.Washout = "simona",
    cab: options.Cab = "gfd",
    dofs: options.Dofs = options.ALL,
    share: Annotated[float, Option(help="of the machine's limits to use")] = 1.0,
    largest_gain: Annotated[float, Option(help="no scaled gain goes above it")] = 1.0,
    rate: Rate = 80.0,
    limits: LimitsFile = None,
    out: options.Out = Path("out/cue"),
) -> None:
    """Find the gains with which a flight just uses the machine."""
    from cmf_mj.machine.cab import load_cab
    from cmf_mj.machine.motion_limits import load_motion_limits
    from cmf_mj.pilot.cueing.flight import tune
    from cmf_mj.pilot.cueing.settings import load_washout, save_washout
    from cmf_mj.pilot.motion import PilotMotion
    from cmf_mj.show import cueing as report

    before, motion = load_washout(washout), PilotMotion.load(flight)
    use: dict[str, Any] = {"share": share, "largest_gain": largest_gain, "rate": rate}
    bounds = load_motion_limits(limits, load_cab(cab).machine)
    tuned = tune(motion, before, cab=cab, dofs=tuple(dofs), limits=bounds, **use)
    path = save_washout(tuned.settings, out / "washout.toml")
    gains = report.tuned_table(tuned, before.gains)
    show(gains, report.excursion_table(tuned.excursion), f"written: {path}")


@command("omct")
def omct_command(
    laws: options.Laws = options.VELOCITY,
    washout: options.Washout = "simona",
    cab: options.Cab = "gfd",
    hydraulics: options.Hydraulics = "hardware",
    dofs: options.Dofs = options.ALL,
    jobs: options.Jobs = None,
    quick: Annotated[bool, Option("--quick", help="only three frequencies")] = False,
    out: options.Out = Path("out/omct"),
) -> None:
    """Objective motion cueing test; `--laws none` leaves law and machine out."""
    from cmf_mj.pilot.omct import FREQUENCIES, omct
    from cmf_mj.show import cueing as report

    machine: dict[str, Any] = {"washout": washout, "cab": cab, "hydraulics": hydraulics}
    frequencies, tested = _QUICK if quick else FREQUENCIES, [] if laws == ["none"] else laws
    with progress_bar() as update:
        machine |= {"frequencies": frequencies, "dofs": dofs, "jobs": jobs, "progress": update}
        result = omct(tested, **machine)
    paths = report.save_omct(result, out)
    show(report.omct_table(result), written(paths))
