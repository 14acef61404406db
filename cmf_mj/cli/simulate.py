"""Simulate: `cmf run`, `compare`, `failure` and `play`."""

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
    noise_option,
    progress_bar,
    quantity_option,
    show,
    written_text,
)
from cmf_mj.cli.options import any_argument, argument, choice, name_or_file, new_file, size
from cmf_mj.core.errors import InputError

if TYPE_CHECKING:
    from cmf_mj.plant.events import Event

command = partial(app.command, rich_help_panel="Simulate")
drawing = options.drawing(command)

_DEFAULT_LAWS = ["velocity", "position_error_rate", "acceleration"]
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
    show(written_text(save_run(record, chosen, folder)))


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


_SOURCES = "scenarios, or Parquet records (of a flight with what its pilot felt)"


def _differing(name: str, names: list[str]) -> str:
    """What of a file's path is not in all paths; its name or a run's folder where nothing is."""
    parts, *others = (Path(path).with_suffix("").parts for path in (name, *names))
    own = [part for part in parts if not all(part in other for other in others)]
    return "/".join(own or [part for part in parts[-2:] if part != "record"])


@command("play")
def play_command(
    sources: Annotated[
        list[str] | None, any_argument(options.SCENARIOS, "[SOURCE]...", _SOURCES)
    ] = None,
    laws: Annotated[
        list[str] | None, name_or_file(options.LAWS, "LAWS", "laws next to each other")
    ] = None,
    machine: options.OtherMachine = None,
    cab: options.OtherCab = None,
    file: Annotated[Path, new_file(help="HTML file")] = Path("out/play.html"),
    speed: Annotated[float, Option(help="times real speed")] = 1.0,
    camera: Annotated[
        str, choice("cli.options:CAMERAS", "CAMERA", "overview, side, front")
    ] = "overview",
    start: Annotated[float, Option(help="time in the runs when the page begins [s]")] = 0.0,
    seconds: Annotated[
        float | None, Option(help="length of the part of the runs [s]; default to the end")
    ] = None,
) -> None:
    """Write runs side by side as a page that plays them."""
    from cmf_mj.show.flight import saved_traces
    from cmf_mj.show.player.play import play

    names = sources or ["heave_sine"]
    if len(names) > 1 and laws:
        raise InputError("laws: are for one scenario; give one, or no laws")
    of_runs = [Path(name) / "record.parquet" for name in names]  # where a name is a run's folder
    names = [
        str(path) if path.is_file() else name for name, path in zip(names, of_runs, strict=True)
    ]
    records, titles = [], []
    files = [Path(name) for name in names if name.endswith(".parquet")]
    with progress_bar() as progress:
        for name in names:
            if name.endswith(".parquet"):
                records.append(cmf_mj.Record.load(name))
                law = records[-1].metadata["law"].replace("_", " ")
                titles.append(f"{_differing(name, names)}: {law}")
                continue
            scenario = cmf_mj.load_scenario(name)
            for law in laws or [str(scenario.law)]:
                run = _changed(scenario, law=law, machine=machine, cab=cab)
                records.append(run.record(progress=progress))
                of_law = f"{Path(law).stem.replace('_', ' ')} law"
                titles.append(of_law if laws else run.title or Path(name).stem)
    traces = saved_traces(files) if len(files) == len(names) else []
    looks: dict[str, Any] = {"speed": speed, "camera": camera, "start": start, "seconds": seconds}
    play(records, file, titles=titles, traces=traces, **looks)
    show(f"written: {file}")
