"""Flight: `cmf fly`, `learn`, `flight`, `cue` and `omct`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Option

import cmf_mj
from cmf_mj.cli import options
from cmf_mj.cli.common import app, noise_option, progress_bar, show, written
from cmf_mj.cli.options import any_argument, choice, file, new_file
from cmf_mj.core.errors import InputError

command = partial(app.command, rich_help_panel="Flight")
drawing = options.drawing(command)

_FLIGHTS, _SCRIPTS = "pilot.flight:all_flight_names", "pilot.scripts:SCRIPTS"
_SOURCE = "script of JSBSim; with --from UDP port of telemetry, or CSV file"
_FLOWN = "name or file; with --from the UDP port of live telemetry"
_FORMATS, _FORMAT = "pilot.telemetry:FORMATS", "xplane, beamng or csv: telemetry"
From = Annotated[str | None, choice(_FORMATS, "FORMAT", _FORMAT, make=partial(Option, "--from"))]
_KNOWN = 6  #: Drawn machines that a learner is made for.
_QUICK = (0.631, 2.512, 10.0)  #: Frequencies of a quick test [rad/s].


def _port(source: str) -> int:
    """The UDP port that a source of live telemetry is."""
    if not (source.isascii() and source.isdigit()):
        raise InputError(f"source: {source!r} is refused; allowed: the UDP port of live telemetry")
    return int(source)


@drawing("fly")
def fly_command(
    flight: Annotated[str, any_argument(_FLIGHTS, "FLIGHT", _FLOWN)],
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

    loaded = [cmf_mj.load_law(name) for name in laws]
    check_distinct("laws", [one.name for one in loaded])
    port, flown = (0, load_flight(flight)) if form is None else (_port(flight), None)
    if flown is None and len(loaded) != 1:
        raise InputError(f"laws: {len(loaded)} for live telemetry; allowed: one")
    how: dict[str, Any] = {"cab": cab, "hydraulics": hydraulics, "electronics": noise_option(noise)}
    length = seconds if flown is None else float(flown.motion.time[-1])
    rides, paths = [], []
    for law in loaded:
        with progress_bar(f"flying {law.name}", seconds=True) as bar:
            watched = how | {"washout": washout, "progress": lambda at, bar=bar: bar(at, length)}
            if flown is None:
                ride = fly_live(str(form), port, law, seconds=length, **watched)
            else:
                ride = fly(flown.motion, law, **watched)
        rides.append(ride)
        folder = plain_path(out, ride.law)
        paths += save_operation(ride.operation, folder)
        paths += report.save_flight(ride, folder)
    paths += report.save_flights(rides, out)
    title = flown.origin.title if flown else f"{form} at port {port}"
    show(title, report.flight_table(rides), unfolded=True)
    for ride in rides:
        kept = "kept within" if ride.use.travel <= 1.0 else "LEFT"
        stroke, speed = ride.use.share[3:5].max(axis=1)
        show(
            f"{ride.law}: {kept} the envelope, legs {stroke:.0%} of their "
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

    asked = cue(load_flight(flight).motion, washout, cab=cab).stream
    machines = [draw_machine(cab, hydraulics, seed, draw) for draw in range(_KNOWN)]  # type: ignore[arg-type]
    plants = [cmf_mj.Hexapod(cab, hydraulics), *machines]
    run: dict[str, Any] = {"electronics": noise_option(noise), "trials": trials, "seed": seed}
    with progress_bar(f"learning {flight}") as update:
        learnt = learn(asked, law, plants, progress=update, **run)
    paths = report.save_learning(learnt, out)
    show(report.trial_table(learnt), unfolded=True)
    show(report.verdict_text(learnt), written(paths, out))


@command("flight")
def flight_command(
    source: Annotated[str, any_argument(_SCRIPTS, "SOURCE", _SOURCE)],
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
        table = form == "csv" and not source.isdigit()
        sent = (read_telemetry(source), 0) if table else listen(form, _port(source), seconds)
        received, refused = sent
        verdict = check_telemetry(received)
        span = float(received.time[-1] - received.time[0])
        show(f"{received.time.size} samples in {span:.1f} s, {refused} datagrams of other form")
        show(*(f"ERROR: {error}" for error in verdict.errors))
        show(*(f"these data cannot show whether {error}" for error in verdict.unseen))
        if verdict.errors:
            raise typer.Exit(1)
        show("no error found")
        flight = flight_of(received, form, Path(source).stem)
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
    flown = cue(load_flight(flight).motion, washout, cab=cab, limits=bounds, rate=rate)
    paths = report.save_cue(flown, out)
    excursion = report.excursion_table(flown.excursion, int(flown.limited.sum()))
    plans = [] if flown.plans is None else [flown.plans]
    show(report.error_table(flown), excursion, *plans, written(paths))


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

    how: dict[str, Any] = {"washout": washout, "cab": cab, "hydraulics": hydraulics}
    frequencies, tested = _QUICK if quick else FREQUENCIES, [] if laws == ["none"] else laws
    with progress_bar() as update:
        how |= {"frequencies": frequencies, "dofs": dofs, "jobs": jobs, "progress": update}
        result = omct(tested, **how)
    paths = report.save_omct(result, out)
    show(report.omct_table(result), written(paths))
