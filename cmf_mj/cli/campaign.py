"""Recordings for a fit: `cmf campaign plan` and `record`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from cmf_mj.cli import options
from cmf_mj.cli.common import app, progress_bar, show
from cmf_mj.cli.options import name_or_file

campaigns = typer.Typer(no_args_is_help=True, help="Recordings that tell a machine: plan, record.")
app.add_typer(campaigns, name="campaign", rich_help_panel="Studies")

_HELD = "of a recording held back; default a slower one"
SomeCab = Annotated[str | None, name_or_file(options.CABS, "CAB", "default the machine's first")]
SomeOil = Annotated[str | None, name_or_file(options.OIL, "SET", "default the machine's")]
SomeLaw = Annotated[str | None, name_or_file(options.LAWS, "LAW", "default the machine's")]


@campaigns.command("plan")
def plan_command(
    machine: options.Machine = "cmf",
    cab: SomeCab = None,
    hydraulics: SomeOil = None,
    law: SomeLaw = None,
    other_law: Annotated[str | None, name_or_file(options.LAWS, "LAW", _HELD)] = None,
    seconds: Annotated[float, Option(help="length of each recording [s]")] = 20.0,
    share: Annotated[float, Option(help="most of a limit that a demand uses")] = 0.4,
    out: options.Out = Path("out/campaign"),
) -> None:
    """Write what to record of a machine: scenarios, host files and campaign.toml."""
    from cmf_mj.studies.fit.plan import plan_campaign

    how: dict[str, Any] = {"seconds": seconds, "share": share, "other_law": other_law}
    show(f"written: {plan_campaign(machine, cab, hydraulics, law, out, **how)}")


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

    what = {"machine": machine, "cab": cab, "hydraulics": hydraulics}
    with progress_bar("recording") as update:
        made = record_campaign(folder, **what, seed=seed, jobs=jobs, progress=update)
    show(f"written: {made}")
