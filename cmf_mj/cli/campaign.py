"""Recordings: `cmf recording`, `campaign`, `fit` and `guide`."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option, echo

import cmf_mj
from cmf_mj.cli import options
from cmf_mj.cli.common import app, progress_bar, show, written_text
from cmf_mj.cli.options import name_or_file, new_file
from cmf_mj.core.errors import InputError, within

recordings = typer.Typer(no_args_is_help=True, help="Recordings of a motion base: map and check.")
app.add_typer(recordings, name="recording", rich_help_panel="Facility")

_FILE = "CSV, Parquet, HDF5 or MAT"
_OF = "name or TOML file; default that of the map, else the CMF"


@recordings.command("new")
def recording_new_command(
    recording: Annotated[Path, Argument(metavar="FILE", help=_FILE)],
    file: Annotated[Path, new_file(help="TOML file")] = Path("out/columns.toml"),
) -> None:
    """Guess from a header which columns are which; the map is to be read and corrected."""
    from cmf_mj.core.files import write_text
    from cmf_mj.record.guess import guess_columns

    show(f"written: {write_text(file, guess_columns(recording))}")


@recordings.command("check")
def recording_check_command(
    files: Annotated[list[Path], Argument(metavar="FILE...", help=_FILE)],
    columns: options.Columns = None,
    machine: Annotated[str | None, options.name_or_file(options.MACHINES, "MACHINE", _OF)] = None,
    cab: Annotated[str | None, Option(metavar="CAB", help="default the machine's first")] = None,
) -> None:
    """Tell whether recordings are what their map says of a machine; status 1 if one is not."""
    from cmf_mj.core.result import Result, fields_of
    from cmf_mj.record.columns import load_columns, read_mapped
    from cmf_mj.studies.recordings import Finding, check_recording, verdict

    column_map = None if columns is None else load_columns(columns)
    loaded = cmf_mj.load_machine(machine or (column_map and column_map.machine) or "cmf")
    findings = {}
    for file in files:  # all of them before a line is shown
        with within(file):
            findings[file] = check_recording(read_mapped(file, column_map, loaded), loaded, cab)
    faulty = [name for name, rows in findings.items() if any(r.status == "fault" for r in rows)]
    if len(findings) == 1:
        file, rows = findings.popitem()
        show(Result(rows, fields_of(Finding), f"{file.name} on {loaded.name}"), verdict(rows))
    else:
        lines = (f"{file}: {verdict(rows)}" for file, rows in findings.items())
        fit_count = len(findings) - len(faulty)
        show(*lines, f"{fit_count} of {len(findings)} recordings fit {loaded.name}")
    if faulty:
        raise typer.Exit(1)


campaigns = typer.Typer(no_args_is_help=True, help="Recordings that tell a machine: plan, record.")
app.add_typer(campaigns, name="campaign", rich_help_panel="Studies")

SomeCab = Annotated[str | None, name_or_file(options.CABS, "CAB", "default the machine's first")]
SomeOil = Annotated[str | None, name_or_file(options.HYDRAULICS, "SET", "default the machine's")]
SomeLaw = Annotated[str | None, name_or_file(options.LAWS, "LAW", "default the machine's")]


@campaigns.command("plan")
def plan_command(
    machine: options.Machine = "cmf",
    cab: SomeCab = None,
    hydraulics: SomeOil = None,
    law: SomeLaw = None,
    seconds: Annotated[float, Option(help="length of each recording [s]")] = 20.0,
    out: options.Out = Path("out/campaign"),
) -> None:
    """Write what to record of a machine: scenarios, host files and campaign.toml."""
    from cmf_mj.studies.fit.plan import plan_campaign

    folder = plan_campaign(machine, cab, hydraulics, law, out, seconds=seconds)
    show(f"written: {folder}")


@campaigns.command("record")
def record_command(
    folder: Annotated[Path, Argument(metavar="FOLDER", help="of the campaign")],
    machine: options.OtherMachine = None,
    cab: SomeCab = None,
    hydraulics: SomeOil = None,
    seed: options.Seed = 0,
    jobs: options.Jobs = None,
) -> None:
    """Record a plan on a simulated machine, with noisy electronics and unequal valves."""
    from cmf_mj.studies.fit.plan import record_campaign

    parts = {"machine": machine, "cab": cab, "hydraulics": hydraulics}
    with progress_bar("recording") as update:
        path = record_campaign(folder, **parts, seed=seed, jobs=jobs, progress=update)
    show(f"written: {path}")


Campaign = Annotated[
    Path, Argument(metavar="CAMPAIGN", help="folder with campaign.toml, or report, hardware")
]


@options.drawing(partial(app.command, rich_help_panel="Studies"))("fit")
def fit_command(
    campaign: Campaign,
    effects: Annotated[bool, Option(help="try what else the machine may have")] = True,
    jobs: options.Jobs = None,
    out: options.Out = Path("out/fit"),
) -> None:
    """Find a machine's numbers from recordings of it, and say how far to trust them.

    report, hardware and hardware_lag are campaigns of what the 2014 report prints.
    """
    from cmf_mj.core.result import Result, fields_of
    from cmf_mj.show.fit import fit_figures
    from cmf_mj.show.look import save_files
    from cmf_mj.studies.fit import doubt, results
    from cmf_mj.studies.fit.engine import fit

    jobs = jobs or os.cpu_count() or 1
    with progress_bar("reading recordings", seconds=True) as bar:
        announce = partial(bar, 0.0, None)
        announce("reading recordings")
        posterior = fit(campaign, out, jobs=jobs, progress=echo, announce=announce)
        announce("looking for what speaks against it")
        doubts = doubt.doubt(posterior, jobs, effects=effects)
    posterior = doubts.widened(posterior)
    results.save(posterior, out)
    table = results.numbers(posterior)
    page = doubts.page_writer(table)
    drawn: dict[str, Any] = {**fit_figures(posterior, doubts.stated), "fit.md": page}
    if doubts.stated:
        stated = Result(doubts.stated, fields_of(doubt.StatedNumber)).table
        drawn |= {"stated.csv": stated.save}
    files = save_files(drawn, out)
    show(table, *doubts.tables(), doubts.verdict, written_text(files, out))


guides = typer.Typer(no_args_is_help=True, help="Test guides: make a master, check against it.")
app.add_typer(guides, name="guide", rich_help_panel="Studies")

SomeGuide = Annotated[str, options.any_argument("studies.guide:GUIDES", "GUIDE", "or TOML file")]


def _with_cueing() -> None:
    """Let guides drive the aircraft and measure at the pilot's station."""
    from cmf_mj.pilot import omct
    from cmf_mj.studies.guide import COMMAND_MAKERS
    from cmf_mj.studies.measurement import MEASURES

    COMMAND_MAKERS["aircraft"] = omct.aircraft_command
    MEASURES["cueing"] = omct.cueing_responses


def _bench(guide: str, out: Path, **named: Any) -> Any:
    """A guide on a machine with its head, to stand in the folder of results."""
    from cmf_mj.studies.guide import load_guide, make_bench, make_head

    _with_cueing()
    on = make_bench(load_guide(guide), **named)
    return on, make_head(on, out, **named)


@guides.command("plan")
def guide_plan_command(
    guide: SomeGuide,
    machine: options.Machine = "cmf",
    cab: SomeCab = None,
    hydraulics: SomeOil = None,
    law: SomeLaw = None,
    out: options.Out = Path("out/guide"),
) -> None:
    """Write the host files of a guide's tests, their order and the time they take."""
    from cmf_mj.studies.guide import plan_guide

    on, head = _bench(guide, out, machine=machine, cab=cab, hydraulics=hydraulics, law=law)
    table = plan_guide(on, head.model_copy(update={"simulated": False}), out)
    show(table, f"written: {out}")


@options.drawing(guides.command)("run")
def guide_run_command(
    guide: SomeGuide,
    machine: options.Machine = "cmf",
    cab: SomeCab = None,
    hydraulics: SomeOil = None,
    law: SomeLaw = None,
    recordings: Annotated[
        Path | None, Option(metavar="FOLDER", help="planned and recorded; default simulate")
    ] = None,
    repetitions: Annotated[int | None, Option(min=1, help="default the guide's")] = None,
    seed: options.Seed = 0,
    jobs: options.Jobs = None,
    out: options.Out = Path("out/guide"),
) -> None:
    """Make the master of a machine, or what is checked against it: recordings, measures, a page."""
    from cmf_mj.show.measurement import save_guide, verdict_table
    from cmf_mj.studies.guide import load_guide, run_guide
    from cmf_mj.studies.guide_check import compare, load_master

    _with_cueing()
    folder = recordings or out
    if recordings is None:
        on, head = _bench(guide, out, machine=machine, cab=cab, hydraulics=hydraulics, law=law)
        how: dict[str, Any] = {"repetitions": repetitions, "seed": seed, "jobs": jobs}
        with progress_bar("recording") as update:
            run_guide(on, head, out, **how, progress=update)
    master = load_master(folder)
    if master.head.guide != load_guide(guide):
        raise InputError(f"recordings: {folder} is of another guide than {guide!r}")
    master.head.write(folder)
    rows = compare(master, master)
    show(verdict_table(rows), written_text(save_guide(master, master, rows, [], folder), folder))


@options.drawing(guides.command)("check")
def guide_check_command(
    new: Annotated[Path, Argument(metavar="NEW", help="folder of `cmf guide run`")],
    against: Annotated[Path, Option(metavar="FOLDER", help="the master")],
    diagnosis: Annotated[bool, Option("--diagnosis/--verdicts", help="ask why")] = True,
    jobs: options.Jobs = None,
    out: options.Out = Path("out/check"),
) -> None:
    """Compare with a master: what has changed, and most probably why."""
    from cmf_mj.show import measurement as report
    from cmf_mj.studies.diagnosis import diagnose, find_slopes
    from cmf_mj.studies.guide_check import compare, load_master

    _with_cueing()
    master, since = load_master(against), load_master(new)
    rows, causes = compare(master, since), []
    changed = any(row.verdict in ("changed", "beyond its limit") for row in rows)
    if changed and diagnosis:
        with progress_bar("simulating") as update:
            causes = diagnose(master, since, find_slopes(master, jobs, update), jobs)
    paths = report.save_guide(master, since, rows, causes, out)
    tables = [report.causes_table(causes).table] if causes else []
    show(report.verdict_table(rows), *tables, written_text(paths, out))
