"""`cmf cue run`, `cmf cue tune` and `cmf omct`."""

from pathlib import Path
from typing import Annotated

import typer

from cmf_mj.cli.common import (
    TEXT_WIDTH,
    Cab,
    HydraulicSet,
    Jobs,
    app,
    names_of,
    progress_bar,
    refuse,
    show,
    written,
)
from cmf_mj.machine.kinematics import DOFS
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.pilot.cueing.flight import cue, tune
from cmf_mj.pilot.cueing.settings import WASHOUTS, load_washout, save_washout
from cmf_mj.pilot.motion import PilotMotion
from cmf_mj.pilot.omct import FREQUENCIES, omct
from cmf_mj.show import cueing as cueing_report
from cmf_mj.show import omct as omct_report

_QUICK = (0.631, 2.512, 10.0)
"""Frequencies of a quick test [rad/s]."""

cues = typer.Typer(no_args_is_help=True, help="A flight in the simulator: washout and gains.")
app.add_typer(cues, name="cue")

Flight = Annotated[
    Path,
    typer.Argument(
        help="CSV or Parquet: time, specific_force_x.. [m/s^2], angular_rate_x.. [rad/s], "
        "roll, pitch, yaw [rad] at the pilot's station"
    ),
]
WashoutName = Annotated[
    str, typer.Option("--washout", help=f"{', '.join(WASHOUTS)} or a TOML file")
]
Rate = Annotated[float, typer.Option(help="host frames a second")]
LimitsFile = Annotated[
    Path | None, typer.Option(help="TOML file of changes to the machine's limits")
]


@cues.command("run")
def run_command(
    flight: Flight,
    washout: WashoutName = "simona",
    cab: Cab = "gfd",
    rate: Rate = 80.0,
    limits: LimitsFile = None,
    senses: Annotated[
        Path | None, typer.Option(help="TOML file of changes to canals, otoliths, thresholds")
    ] = None,
    out: Annotated[Path, typer.Option(help="folder for results")] = Path("out/cue"),
) -> None:
    """Turn a flight into host frames and tell what the pilot senses of it."""
    try:
        flown = cue(
            PilotMotion.load(flight),
            washout,
            cab=cab,
            limits=load_motion_limits(limits),
            senses=None if senses is None else str(senses),
            rate=rate,
        )
        paths = cueing_report.save_cue(flown, out)
        show(
            cueing_report.error_table(flown),
            cueing_report.excursion_table(flown.excursion, int(flown.held.sum())),
            written(paths),
            width=TEXT_WIDTH,
        )
    except (ValueError, OSError) as error:
        refuse(error)


@cues.command("tune")
def tune_command(
    flight: Flight,
    washout: WashoutName = "simona",
    cab: Cab = "gfd",
    dofs: Annotated[str, typer.Option(help="whose gains to scale, or `all`")] = "all",
    share: Annotated[float, typer.Option(help="of the machine's limits to use")] = 1.0,
    largest_gain: Annotated[float, typer.Option(help="no scaled gain goes above it")] = 1.0,
    rate: Rate = 80.0,
    limits: LimitsFile = None,
    out: Annotated[Path, typer.Option(help="folder for results")] = Path("out/tune"),
) -> None:
    """Find the gains with which a flight just uses the machine."""
    try:
        before = load_washout(washout)
        tuned = tune(
            PilotMotion.load(flight),
            before,
            cab=cab,
            dofs=tuple(names_of(dofs, DOFS)),
            share=share,
            largest_gain=largest_gain,
            limits=load_motion_limits(limits),
            rate=rate,
        )
        path = save_washout(tuned.settings, out / "washout.toml")
        show(
            cueing_report.tuned_table(tuned, before.gains),
            cueing_report.excursion_table(tuned.excursion),
            f"written: {path}",
            width=TEXT_WIDTH,
        )
    except (ValueError, OSError) as error:
        refuse(error)


@app.command("omct")
def omct_command(
    laws: Annotated[str, typer.Option(help="laws or TOML files, or `none`")] = "velocity",
    washout: WashoutName = "simona",
    cab: Cab = "gfd",
    hydraulics: HydraulicSet = "hardware",
    inputs: Annotated[str, typer.Option(help="inputs to drive, or `all`")] = "all",
    jobs: Jobs = None,
    quick: Annotated[
        bool, typer.Option("--quick", help=f"only {', '.join(map(str, _QUICK))} rad/s")
    ] = False,
    out: Annotated[Path, typer.Option(help="folder for results")] = Path("out/omct"),
) -> None:
    """Objective motion cueing test: aircraft to simulator through washout, DCU, law and machine."""
    try:
        with progress_bar() as update:
            result = omct(
                [] if laws == "none" else names_of(laws, ()),
                washout=washout,
                cab=cab,
                hydraulics=hydraulics,
                frequencies=_QUICK if quick else FREQUENCIES,
                dofs=names_of(inputs, DOFS),
                jobs=jobs,
                progress=update,
            )
        paths = omct_report.save_omct(result, out)
        show(omct_report.omct_table(result), written(paths), width=TEXT_WIDTH)
    except (ValueError, OSError) as error:
        refuse(error)
