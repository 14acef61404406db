"""A machine from its recordings: `cmf fit`."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option, echo

from cmf_mj.cli import options
from cmf_mj.cli.campaign import campaigns
from cmf_mj.cli.common import app, show, written

Campaign = Annotated[
    Path, Argument(metavar="CAMPAIGN", help="folder with campaign.toml, or report, hardware")
]
Try = Annotated[bool, Option("--effects/--no-effects", help="try what else the machine may have")]


@options.drawing(partial(app.command, rich_help_panel="Studies"))("fit")
def fit_command(
    campaign: Campaign,
    effects: Try = True,
    jobs: options.Jobs = None,
    out: options.Out = Path("out/fit"),
) -> None:
    """Find a machine's numbers from recordings of it, and say how far to trust them.

    report, hardware and hardware_lag are campaigns of what the 2014 report prints.
    """
    from cmf_mj.core.result import Result, fields_of
    from cmf_mj.show.fit import figures
    from cmf_mj.show.look import save_files
    from cmf_mj.studies.fit import doubt, results
    from cmf_mj.studies.fit.campaign import load_campaign
    from cmf_mj.studies.fit.engine import fit
    from cmf_mj.studies.fit.stated import Stated

    jobs = jobs or os.cpu_count() or 1
    posterior = fit(load_campaign(campaign), out, jobs=jobs, progress=echo)
    doubts = doubt.doubt(posterior, jobs, effects=effects)
    posterior = doubts.widened(posterior)
    results.save(posterior, out)
    table = results.numbers(posterior)
    drawn: dict[str, Any] = {**figures(posterior, doubts.stated), "fit.md": doubts.page(table)}
    if doubts.stated:
        stated = Result(doubts.stated, fields_of(Stated)).table
        drawn |= {"stated.csv": stated.save}
    files = save_files(drawn, out)
    show(table, *doubts.tables(), doubts.verdict, written(files, out))


@campaigns.command("next")
def next_command(
    campaign: Campaign,
    plan: Annotated[Path, Argument(metavar="PLAN", help="folder of `cmf campaign plan`")],
    number: Annotated[str, Option(help="to be known better, or `damping` of the law")] = "damping",
    jobs: options.Jobs = None,
    fitted: Annotated[Path, Option("--fit", metavar="FOLDER", help="of the fit")] = Path("out/fit"),
) -> None:
    """Say which planned recording would narrow a number most, after a fit."""
    from cmf_mj.core.result import Result, fields_of
    from cmf_mj.studies.fit.campaign import load_campaign
    from cmf_mj.studies.fit.engine import fit
    from cmf_mj.studies.fit.worth import Worth, worth

    jobs = jobs or os.cpu_count() or 1
    posterior = fit(load_campaign(campaign), fitted, jobs=jobs, progress=echo)
    rows = worth(posterior, plan, number, jobs)
    show(Result(rows, fields_of(Worth), f"What to record next for {number}").table)
