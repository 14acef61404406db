"""Simulate: `cmf run`, `compare`, `failure`, `capacity`, `video` and `studio`."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Context, Option

import cmf_mj
from cmf_mj.cli import options
from cmf_mj.cli.common import (
    amplitude_option,
    app,
    claim,
    given_by_user,
    noise_option,
    progress_bar,
    quantity_option,
    show,
    written,
)
from cmf_mj.cli.options import argument, name_or_file, new_file, size
from cmf_mj.core.errors import InputError, require

if TYPE_CHECKING:
    from cmf_mj.plant.events import Event

command = partial(app.command, rich_help_panel="Simulate")
drawing = options.drawing(command)

_DEFAULT_LAWS = ["velocity", "position_error_rate", "acceleration"]
_MOTIONS = (
    "sine, step, chirp, noise, multisine, or a CSV or Parquet file with columns "
    "time [s], surge, sway, heave [m], roll, pitch, yaw [rad]"
)
_SIGNALS = "studies.capacity:SIGNALS"
_SIZE = "of sweeps in translation; rotations are 0.2 deg, steps 1 in for every 0.33 in of it"


def _changed(scenario: Any, **fields: object) -> Any:
    """A scenario with other fields, checked again; None leaves a field."""
    from cmf_mj.facility.scenario import scenario_of

    changes = {name: value for name, value in fields.items() if value is not None}
    return scenario_of(scenario.table() | changes, "options")


@drawing("run")
def run_command(
    context: Context,
    scenario: options.Scenario = "",
    machine: options.OtherMachine = None,
    cab: options.OtherCab = None,
    out: options.NamedOut = None,
    schema: Annotated[bool, Option("--schema", help="print a scenario's JSON schema")] = False,
) -> None:
    """Run a scenario: plant, law, signals, failures and changes; without one, list them."""
    from cmf_mj.facility.scenario import scenario_names
    from cmf_mj.show.operation import save_run

    if schema:
        print(json.dumps(cmf_mj.Run.model_json_schema(), indent=2))
        return
    if not scenario:
        for name in scenario_names():
            show(f"{name:24} {cmf_mj.load_scenario(name).title}")
        return
    chosen = _changed(cmf_mj.load_scenario(scenario), machine=machine, cab=cab)
    folder = claim(context, out or Path("out/run") / Path(scenario).stem)
    with progress_bar() as progress:
        record = chosen.record(progress=progress)
    show(written(save_run(record, chosen, folder)))


@drawing("compare")
def compare_command(
    laws: options.Laws = _DEFAULT_LAWS,
    dofs: options.Dofs = options.ALL,
    machine: options.Machine = "cmf",
    cab: options.Cab = "gfd",
    plants: options.Plants = options.ALL,
    hydraulics: options.Hydraulics = "hardware",
    amplitude: Annotated[str, size(help=_SIZE)] = "0.33 in",
    jobs: options.Jobs = None,
    out: options.Out = Path("out/compare"),
    quick: options.Quick = False,
    records: Annotated[bool, Option(help="keep all runs, about 8 MB a case")] = True,
    noise: options.Noise = False,
) -> None:
    """Compare control laws in six degrees of freedom on the hexapod and on single legs."""
    from cmf_mj.show import comparison as report

    built = {"plants": plants, "cab": cab, "hydraulics": hydraulics, "quick": quick}
    size = amplitude_option("heave", amplitude)
    changed = {"amplitude": size, "electronics": noise_option(noise)}
    how: dict[str, Any] = {**built, **changed, "jobs": jobs}
    with progress_bar() as update:
        folder = out / "records" if records else None
        comparison = cmf_mj.compare(laws, dofs, records=folder, progress=update, **how)
    dropped = report.drop_comparison(out, comparison, records)
    paths = report.save_comparison(comparison, out)
    gap = max(result.gimbal_error for result in comparison)
    files = f"comparison.csv, comparison.md, {len(paths) - 2} figures"
    earlier = f"\nremoved first: {dropped} files of an earlier comparison" if dropped else ""
    show(
        report.comparison_table(comparison),
        f"largest gap of a closed gimbal: {gap * 1e6:.2f} micrometres",
        f"written to {out}: {files}{', records/' if records else ''}{earlier}",
        unfolded=True,
    )


def events_of(
    kinds: list[str], at: float, leg: int | None, valve: int | None, size: str | None
) -> list[Event]:
    """Events of the command line; of several kinds, valves once both and once the first."""
    from cmf_mj.plant.events import default_event

    amount = None if size is None else quantity_option("size", size)
    if len(kinds) == 1:
        return [default_event(kinds[0], at, leg=leg, valve=valve, size=amount)]
    if amount is not None or valve is not None:
        raise InputError("size, valve: are for one event; several events take their defaults")
    events = []
    for kind in kinds:
        local = default_event(kind, at).leg is not None
        for number in (None, 1) if kind.startswith("valve") else (None,):
            events.append(default_event(kind, at, leg=leg if local else None, valve=number))
    return events


@drawing("failure")
def failure_command(
    event: Annotated[list[str], argument("plant.events:KINDS", "EVENT", "what fails, or `all`")],
    dof: options.Dof = "heave",
    leg: Annotated[int | None, Option(help="leg of a valve or sensor; default 1")] = None,
    valve: Annotated[int | None, Option(help="1 or 2; default both")] = None,
    size: Annotated[str | None, size(help="how much, such as '1 in^2'")] = None,
    at: Annotated[float, Option(help="time of the event [s]")] = 4.0,
    after: Annotated[float, Option(help="length of the run after it [s]")] = 26.0,
    law: options.Law = "velocity",
    machine: options.Machine = "cmf",
    cab: options.Cab = "gfd",
    hydraulics: options.Hydraulics = "hardware",
    amplitude: Annotated[str | None, size(help="of the sine; on the CMF '6 in' or '4 deg'")] = None,
    frequency: Annotated[float, Option(help="of the sine [Hz]")] = 0.5,
    protection: Annotated[bool, Option(help="whether a fault stops the machine")] = True,
    jobs: options.Jobs = None,
    out: options.Out = Path("out/failure"),
) -> None:
    """Let something fail during a manoeuvre: leg loads, what the crew feels, how it ends."""
    from cmf_mj.show import study as report
    from cmf_mj.studies.case import make_case
    from cmf_mj.studies.failure import run_failures

    events, sine = events_of(event, at, leg, valve, size), amplitude_option(dof, amplitude)
    case = make_case(law, dof, cab=cab, hydraulics=hydraulics, amplitude=sine)
    how: dict[str, Any] = {"protection": "default" if protection else None, "jobs": jobs}
    results = run_failures(events, case, frequency=frequency, after=after, **how)
    paths = report.save_failures(results, out)
    load = max(results, key=lambda result: abs(result.load.after.value)).load.after
    show(
        results,
        *[result.message for result in results if result.message],
        f"largest load: {load.value / 1e3:.1f} kN in leg {load.leg}",
        f"written to {out}: failures.csv, failures.md, {len(paths) - 2} figures",
        unfolded=True,
    )


@drawing("capacity")
def capacity_command(
    signal: Annotated[str, name_or_file(_SIGNALS, "SIGNAL", _MOTIONS)] = "sine",
    dof: options.Dof = "heave",
    amplitude: Annotated[str | None, size(help="with its unit; sine on the CMF '15 in'")] = None,
    frequency: Annotated[float | None, Option(help="of the sine, else the highest [Hz]")] = None,
    law: options.Law = "velocity",
    machine: options.Machine = "cmf",
    cab: options.Cab = "gfd",
    hydraulics: options.Hydraulics = "hardware",
    least_pressure: Annotated[float | None, Option(help="[psi]; default 80 % of the set's")] = None,
    dofs: options.Dofs = options.ALL,
    out: options.Out = Path("out/capacity"),
) -> None:
    """Does the supply hold through a manoeuvre (--dof), and what is the largest (--dofs)?"""
    from cmf_mj.core import units
    from cmf_mj.show import operation as report
    from cmf_mj.studies import asymptotes
    from cmf_mj.studies.capacity import capacity, manoeuvre

    plant = cmf_mj.Hexapod(cab, hydraulics)
    least = None if least_pressure is None else least_pressure * units.PSI
    demand = manoeuvre(signal, dof, amplitude_option(dof, amplitude), frequency, machine)
    result = capacity(demand, plant, law, least_pressure=least)
    paths = report.save_capacity(result, plant, dofs, out)
    show(report.capacity_result(result).turned, asymptotes.envelope(plant, dofs), written(paths))


_SOURCES = "scenarios, or Parquet records (of a flight with what its pilot felt)"


def _differing(name: str, names: list[str]) -> str:
    """What of a file's path is not in all paths; its name or a run's folder where nothing is."""
    parts, *others = (Path(one).with_suffix("").parts for one in (name, *names))
    own = [part for part in parts if not all(part in other for other in others)]
    return "/".join(own or [part for part in parts[-2:] if part != "record"])


@command("video")
def video_command(
    context: Context,
    sources: Annotated[
        list[str] | None, argument(options.SCENARIOS, "[SOURCE]...", _SOURCES, free=True)
    ] = None,
    laws: Annotated[
        list[str] | None, name_or_file(options.LAWS, "LAWS", "laws next to each other")
    ] = None,
    machine: options.OtherMachine = None,
    cab: options.OtherCab = None,
    file: Annotated[Path, new_file(help="MP4 file, or HTML page to play")] = Path("out/video.mp4"),
    fps: options.Fps = 30,
    speed: options.Speed = 1.0,
    camera: options.Camera = "overview",
    width: options.Width = 720,
    height: options.Height = 450,
    start: options.Start = 0.0,
    seconds: options.Seconds = None,
) -> None:
    """Show runs side by side, as MP4 or an HTML page; needs no display."""
    from cmf_mj.show.film import FilmSettings, film
    from cmf_mj.show.flight import saved_traces

    given = [name for name in ("fps", "width", "height") if given_by_user(context, name)]
    if given and file.suffix == ".html":
        text = "a page is as large as its window and draws as fast as its browser"
        raise InputError(f"{', '.join(given)}: {text}; leave out, or write .mp4")
    names = sources or ["heave_sine"]
    kept = [Path(name) / "record.parquet" for name in names]  # of folders of runs
    names = [str(path) if path.is_file() else name for name, path in zip(names, kept, strict=True)]
    look = FilmSettings(fps, speed, camera, width, height, start=start, seconds=seconds)
    if len(names) > 1 and laws:
        raise InputError("laws: are for one scenario; give one, or no laws")
    records, titles = [], []
    files = [Path(name) for name in names if name.endswith(".parquet")]
    with progress_bar() as progress:
        for name in names:
            if name.endswith(".parquet"):
                records.append(cmf_mj.Record.load(name))
                law = records[-1].metadata["law"].replace("_", " ")
                titles.append(f"{_differing(name, names)}: {law}")
                continue
            base = cmf_mj.load_scenario(name)
            for law in laws or [str(base.law)]:
                one = _changed(base, law=law, machine=machine, cab=cab)
                records.append(one.record(progress=progress))
                said = f"{Path(law).stem.replace('_', ' ')} law"
                titles.append(said if laws else one.title or Path(name).stem)
    traces = saved_traces(files) if len(files) == len(names) else []
    if traces:
        look = look._replace(strip=300)
    with progress_bar("drawing", compiles=False) as progress:
        path = film(records, file, look, titles=titles, traces=traces, progress=progress)
    show(f"written: {path}")


@command("studio")
def studio_command(
    scenario: options.Scenario = "",
    machine: options.OtherMachine = None,
    law: options.OtherLaw = None,
    cab: options.OtherCab = None,
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

    for package in ("viser", "mjviser"):
        require(package, "studio")
    from cmf_mj.show.studio.desk import ready_scenarios
    from cmf_mj.show.studio.server import Studio

    # A picture on its way to a tab that has just been closed is nothing to tell of.
    warnings.filterwarnings("ignore", message="Queued a .* on a closed connection")
    begun = cmf_mj.load_scenario(scenario) if scenario else ready_scenarios()["studio"]
    print("compiling the loop: up to a minute the first time", flush=True)
    studio = Studio(host, port, _changed(begun, machine=machine, law=law, cab=cab))
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
