"""Recordings of any machine: `cmf recording new` and `check`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

import cmf_mj
from cmf_mj.cli import options
from cmf_mj.cli.common import app, show
from cmf_mj.cli.options import new_file

recordings = typer.Typer(no_args_is_help=True, help="Recordings of a motion base: map and check.")
app.add_typer(recordings, name="recording", rich_help_panel="Facility")

_FILE = "CSV, Parquet, HDF5 or MAT"
_MAP = "TOML file of `cmf recording new`; default the facility's columns"
_OF = "name or TOML file; default that of the map, else the CMF"

Recording = Annotated[Path, Argument(metavar="FILE", help=_FILE)]


@recordings.command("new")
def new_command(
    recording: Recording,
    file: Annotated[Path, new_file(help="TOML file")] = Path("out/columns.toml"),
) -> None:
    """Guess from a header which columns are which; the map is to be read and corrected."""
    from cmf_mj.core.files import write_text
    from cmf_mj.record.guess import guess_columns

    show(f"written: {write_text(file, guess_columns(recording))}")


@recordings.command("check")
def check_command(
    recording: Recording,
    columns: Annotated[Path | None, Option(metavar="MAP", help=_MAP)] = None,
    machine: Annotated[str | None, options.name_or_file(options.MACHINES, "MACHINE", _OF)] = None,
    cab: Annotated[str | None, Option(metavar="CAB", help="default the machine's first")] = None,
) -> None:
    """Tell whether a recording is what its map says of a machine; status 1 if it is not."""
    from cmf_mj.core.result import Result, fields_of
    from cmf_mj.record.columns import load_columns, read_mapped
    from cmf_mj.studies.recordings import Finding, check_recording, verdict

    known = None if columns is None else load_columns(columns)
    chosen = cmf_mj.load_machine(machine or (known and known.machine) or "cmf")
    found = check_recording(read_mapped(recording, known, chosen), chosen, cab)
    rows = Result(found, fields_of(Finding), f"{recording.name} on {chosen.name}")
    show(rows, verdict(found))
    if any(one.status == "fault" for one in found):
        raise typer.Exit(1)
