"""Flight: `cmf fly`, `learn`, `flight`, `cue` and `omct`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Option

import cmf_mj
from cmf_mj.cli import options
from cmf_mj.cli.common import app, noise_option, progress_bar, show, written_text
from cmf_mj.cli.options import any_argument, choice, file, new_file
from cmf_mj.core.errors import InputError

command = partial(app.command, rich_help_panel="Flight")
drawing = options.drawing(command)

_FLIGHTS, _SCRIPTS = "pilot.flight:all_flight_names", "pilot.scripts:SCRIPTS"
_SOURCE_HELP = "script of JSBSim; with --from UDP port of telemetry, or CSV file"
_FLIGHT = "name or file; with --from the UDP port of live telemetry"
_FORMATS, _FORMAT = "pilot.telemetry:FORMATS", "xplane, beamng or csv: telemetry"
From = Annotated[str | None, choice(_FORMATS, "FORMAT", _FORMAT, make=partial(Option, "--from"))]
_LEARNER_MACHINES = 6  #: Drawn machines that a learner is made for.
_QUICK_FREQUENCIES = (0.631, 2.512, 10.0)  #: Frequencies of a quick test [rad/s].


def _port(source: str) -> int:
    """The UDP port that a source of live telemetry is."""
    if not (source.isascii() and source.isdigit()):
        raise InputError(f"source: {source!r} is refused; allowed: the UDP port of live telemetry")
    return int(source)


@drawing("fly")
def fly_command(
    flight: Annotated[str, any_argument(_FLIGHTS, "FLIGHT", _FLIGHT)],
    form: From = None,
    laws: options.Laws = options.VELOCITY,
    machine: options.Machine = "cmf",
    cab: options.Cab = "gfd",
    washout: options.Washout = "simona",
    hydraulics: options.Hydraulics = "hardware",
    noise: options.Noise = True,
    seconds: Annotated[float, Option(help="length of live telemetry [s]")] = 60.0,
    out: options.Out = Path("out/fly"),
) -> None:
    """Fly an aircraft in the cab, once for each law, and compare what the pilot feels."""
    from cmf_mj.core.files import plain_path
    from cmf_mj.core.settings import check_distinct
    from cmf_mj.pilot.flight import load_flight
    from cmf_mj.pilot.fly import fly
    from cmf_mj.pilot.live import fly_live
    from cmf_mj.show import flight as report
    from cmf_mj.show.operation import save_operation

    loaded_laws = [cmf_mj.load_law(name) for name in laws]
    check_distinct("laws", [law.name for law in loaded_laws])
    port, recorded = (0, load_flight(flight)) if form is None else (_port(flight), None)
    if recorded is None and len(loaded_laws) != 1:
        raise InputError(f"laws: {len(loaded_laws)} for live telemetry; allowed: one")
    length = seconds if recorded is None else float(recorded.motion.time[-1])
    ride_options: dict[str, Any] = {"cab": cab, "hydraulics": hydraulics, "washout": washout}
    ride_options["electronics"] = noise_option(noise)
    rides, paths = [], []
    for law in loaded_laws:
        with progress_bar(f"flying {law.name}", seconds=True) as bar:
            ride_options["progress"] = lambda time, bar=bar: bar(time, length)
            if recorded is None:
                ride = fly_live(str(form), port, law, seconds=length, **ride_options)
            else:
                ride = fly(recorded.motion, law, **ride_options)
        rides.append(ride)
        folder = plain_path(out, ride.law)
        paths += save_operation(ride.operation, folder)
        paths += report.save_flight(ride, folder)
    paths += report.save_flights(rides, out)
    title = recorded.origin.title if recorded else f"{form} at port {port}"
    show(title, report.flight_table(rides), unfolded=True)
    for ride in rides:
        verdict = "kept within" if ride.use.travel <= 1.0 else "LEFT"
        stroke, speed = ride.use.share[3:5].max(axis=1)
        show(
            f"{ride.law}: {verdict} the envelope, legs {stroke:.0%} of their "
            f"stroke, {speed:.0%} of their speed, {int(ride.limited.sum())} "
            f"host frames held back; host to legs "
            f"{1e3 * (ride.host_delay + ride.loop_delay):.0f} ms",
            *([] if ride.plans is None else [f"{ride.law}: {ride.plans}"]),
            *([f"{ride.refused} datagrams of other form"] if ride.refused else []),
        )
    show(f"written to {out}: {len(paths)} files")


@drawing("learn")
def learn_command(
    flight: Annotated[str, any_argument(_FLIGHTS, "FLIGHT", "name or file")],
    law: options.Law = "velocity",
    machine: options.Machine = "cmf",
    cab: options.Cab = "gfd",
    washout: options.Washout = "simona",
    hydraulics: options.Hydraulics = "hardware",
    noise: options.Noise = True,
    trials: Annotated[int, Option(min=1, help="runs after the first")] = 8,
    seed: options.Seed = 0,
    out: options.Out = Path("out/learn"),
) -> None:
    """Repeat a flight and learn the demand with which the cab follows it."""
    from cmf_mj.pilot.cueing import cue
    from cmf_mj.pilot.flight import load_flight
    from cmf_mj.pilot.learning import draw_machine, learn
    from cmf_mj.show import flight as report

    demand = cue(load_flight(flight).motion, washout, cab=cab).stream
    machines = [draw_machine(cab, hydraulics, seed, draw) for draw in range(_LEARNER_MACHINES)]  # type: ignore[arg-type]
    plants = [cmf_mj.Hexapod(cab, hydraulics), *machines]
    run: dict[str, Any] = {"electronics": noise_option(noise), "trials": trials, "seed": seed}
    with progress_bar(f"learning {flight}") as update:
        learning = learn(demand, law, plants, progress=update, **run)
    paths = report.save_learning(learning, out)
    show(report.trial_table(learning), unfolded=True)
    show(report.verdict_text(learning), written_text(paths, out))


@command("flight")
def flight_command(
    source: Annotated[str, any_argument(_SCRIPTS, "SOURCE", _SOURCE_HELP)],
    form: From = None,
    file: Annotated[Path | None, new_file(help="CSV or Parquet file to write it to")] = None,
    seed: options.Seed = 1,
    seconds: Annotated[float, Option(help="to listen at a port [s]", min=1.0, max=3600.0)] = 20.0,
) -> None:
    """Fly a script with JSBSim, or say what is wrong with telemetry: axes, signs, units, gaps."""
    from cmf_mj.core.result import number
    from cmf_mj.pilot.scripts import fly_script
    from cmf_mj.pilot.telemetry import flight_of, listen, read_telemetry
    from cmf_mj.pilot.telemetry_check import check_telemetry

    if form is None:
        flight = fly_script(source, seed)
        x, y, z = (number(arm, ".2f") for arm in flight.origin.lever_arm)
        show(
            f"{flight.origin.title}: {flight.motion.time.size} samples at 80 Hz",
            f"pilot's station from the centre of gravity: {x} m forward, {y} right, {z} down",
        )
    else:
        if form == "csv" and not source.isdigit():
            telemetry, refused = read_telemetry(source), 0
        else:
            telemetry, refused = listen(form, _port(source), seconds)
        verdict = check_telemetry(telemetry)
        span = float(telemetry.time[-1] - telemetry.time[0])
        show(f"{telemetry.time.size} samples in {span:.1f} s, {refused} datagrams of other form")
        show(*(f"ERROR: {error}" for error in verdict.errors))
        show(*(f"these data cannot show whether {error}" for error in verdict.unseen))
        if verdict.errors:
            raise typer.Exit(1)
        show("no error found")
        flight = flight_of(telemetry, form, Path(source).stem)
    if file is not None:
        show(f"written: {flight.save(file)}")


@drawing("cue")
def cue_command(
    flight: Annotated[str, any_argument(_FLIGHTS, "FLIGHT", "name or file")],
    washout: options.Washout = "simona",
    machine: options.Machine = "cmf",
    cab: options.Cab = "gfd",
    rate: Annotated[float, Option(min=1.0, max=2048.0, help="host frames a second")] = 80.0,
    limits: Annotated[Path | None, file(help="TOML changes to the machine's limits")] = None,
    out: options.Out = Path("out/cue"),
) -> None:
    """Turn a flight into host frames and what the pilot senses."""
    from cmf_mj.machine.motion_limits import load_motion_limits
    from cmf_mj.pilot.cueing import cue
    from cmf_mj.pilot.flight import load_flight
    from cmf_mj.show import cueing as report

    bounds = load_motion_limits(limits, cmf_mj.load_cab(cab).machine)
    cueing = cue(load_flight(flight).motion, washout, cab=cab, limits=bounds, rate=rate)
    paths = report.save_cue(cueing, out)
    excursion = report.excursion_table(cueing.excursion, int(cueing.limited.sum()))
    plans = [] if cueing.plans is None else [cueing.plans]
    show(report.error_table(cueing), excursion, *plans, written_text(paths))


@drawing("omct")
def omct_command(
    laws: options.Laws = options.VELOCITY,
    washout: options.Washout = "simona",
    machine: options.Machine = "cmf",
    cab: options.Cab = "gfd",
    hydraulics: options.Hydraulics = "hardware",
    dofs: options.Dofs = options.ALL,
    jobs: options.Jobs = None,
    quick: Annotated[bool, Option("--quick", help="only three frequencies")] = False,
    out: options.Out = Path("out/omct"),
) -> None:
    """Objective motion cueing test; `--laws none` leaves law and machine out."""
    from cmf_mj.pilot.omct import FREQUENCIES, omct
    from cmf_mj.show import omct as report

    test: dict[str, Any] = {"washout": washout, "cab": cab, "hydraulics": hydraulics, "dofs": dofs}
    test["frequencies"] = _QUICK_FREQUENCIES if quick else FREQUENCIES
    with progress_bar() as update:
        result = omct([] if laws == ["none"] else laws, jobs=jobs, progress=update, **test)
    paths = report.save_omct(result, out)
    show(report.omct_table(result), written_text(paths))
