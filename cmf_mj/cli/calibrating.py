"""`cmf calibrate`."""

from pathlib import Path
from typing import Annotated

import typer

from cmf_mj.cli.common import TEXT_WIDTH, Jobs, app, names_of, refuse, show, written
from cmf_mj.show import calibration as calibration_report
from cmf_mj.studies.calibration.definition import load_studies, load_study
from cmf_mj.studies.calibration.examination import examine
from cmf_mj.studies.calibration.fit import calibrate


@app.command("calibrate")
def calibrate_command(
    study: Annotated[
        str, typer.Option(help="report, hardware, hardware_lag, several with commas, or `all`")
    ] = "all",
    rounds: Annotated[int, typer.Option(help="fits, each followed by a simulation")] = 1,
    quick: Annotated[bool, typer.Option("--quick", help="sweeps of 30 s instead of 100 s")] = False,
    samples: Annotated[int, typer.Option(help="samples for the uncertainty")] = 128,
    jobs: Jobs = None,
    out: Annotated[Path, typer.Option(help="folder for results")] = Path("out/calibrate"),
) -> None:
    """Fit the free parameters to the published tables; residuals, sensitivities, uncertainty."""
    try:
        studies = [load_study(name) for name in names_of(study, tuple(load_studies()))]
        for chosen in studies:
            fitted = calibrate(chosen, rounds=rounds, quick=quick, jobs=jobs, progress=_tell)
            found = examine(fitted, samples=samples, jobs=jobs)
            paths = calibration_report.save_calibration(found, out / chosen.name)
            verdict = calibration_report.verdict_text(found)
            show(
                *calibration_report.tables(found),
                verdict,
                written(paths, out / chosen.name),
                width=TEXT_WIDTH,
            )
    except (ValueError, OSError, FloatingPointError) as error:
        refuse(error)


def _tell(line: str) -> None:
    typer.echo(line, err=True)
