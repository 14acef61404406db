"""Studies: `cmf study`, `ablation`, `tune` and `calibrate`."""

from __future__ import annotations

import os
import sys
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Option

from cmf_mj.cli import options
from cmf_mj.cli.common import app, progress_bar, show, written
from cmf_mj.cli.options import argument, choice

command = partial(app.command, rich_help_panel="Studies")

Laws = Annotated[
    list[str] | None, choice(options.LAWS, "LAWS", "laws instead of the study's", free=True)
]
Workers = Annotated[
    str, choice("studies.engine:Backend", "BACKEND", "threading, loky (processes) or dask")
]
Address = Annotated[str | None, Option(help="address of a running Dask scheduler")]


def _run(
    specification: str,
    out: Path,
    laws: list[str] | None,
    jobs: int | None,
    backend: str,
    scheduler: str | None,
    **changes: Any,
) -> None:
    """Run a study with some of its fields changed; None leaves a field."""
    from cmf_mj.show import study as report
    from cmf_mj.studies.engine import run_study
    from cmf_mj.studies.settings import load_study

    changes = {name: value for name, value in changes.items() if value is not None}
    study = load_study(specification, laws=laws, changes=changes)
    try:
        with progress_bar() as update:
            table = run_study(
                study,
                out,
                jobs=jobs if jobs is not None else os.cpu_count() or 1,
                backend="dask" if scheduler else backend,  # type: ignore[arg-type]
                scheduler=scheduler,
                progress=update,
            )
        paths = report.save_report(table, out)
        show(report.summary_table(table), written(paths, out))
    except KeyboardInterrupt:
        typer.secho(f"cmf: interrupted; the same command goes on with {out}", err=True)
        if backend == "threading":
            sys.stderr.flush()
            os._exit(130)  # threads still compute: they would outlive what they compute on
        raise SystemExit(130) from None


@command("study")
def study_command(
    specification: Annotated[
        str,
        argument(
            "studies.settings:ready_studies",
            "STUDY",
            "shipped study by name, or TOML file",
            free=True,
        ),
    ],
    out: Annotated[Path | None, Option(help="folder; default out/NAME")] = None,
    laws: Laws = None,
    draws: Annotated[int | None, Option(help="random samples of the machine")] = None,
    jobs: options.Jobs = None,
    backend: Workers = "loky",
    scheduler: Address = None,
) -> None:
    """Run a study of many cases, or what is left of it; the same command resumes it."""
    folder = out or Path("out") / Path(specification).stem
    _run(specification, folder, laws, jobs, backend, scheduler, draws=draws)


@command("ablation")
def ablation_command(
    out: options.Out = Path("out/ablation"),
    laws: Laws = None,
    dofs: Annotated[
        list[str] | None, choice(options.DOFS, "DOFS", "degrees of freedom, or `all`")
    ] = None,
    jobs: options.Jobs = None,
    backend: Workers = "loky",
    scheduler: Address = None,
) -> None:
    """Climb from a single leg to the whole machine, one effect at a time."""
    _run("ablation", out, laws, jobs, backend, scheduler, dofs=dofs)


@command("tune")
def tune_command(
    name: Annotated[str, Option(help="name of the law")] = "modal_plan",
    form: Annotated[
        str, choice("studies.tuning.forms:FORMS", "FORM", "law whose gains are searched")
    ] = "modal_plan",
    title: Annotated[str, Option(help="its title")] = "Modal plan",
    peak: Annotated[float, Option(help="largest peak gain [dB]")] = 2.0,
    overshoot: Annotated[float, Option(help="largest overshoot of a step [%]")] = 18.0,
    cabs: options.Cabs = options.ALL,
    evaluations: Annotated[int, Option(help="laws to try, about")] = 24,
    seed: options.Seed = 1,
    file: Annotated[Path, Option(metavar="FILE", help="law file to write")] = Path(
        "out/tune/law.toml"
    ),
) -> None:
    """Search the gains of a form of law over all cabs and degrees of freedom."""
    from cmf_mj.studies.tuning.forms import make_template
    from cmf_mj.studies.tuning.search import Limits, save_law, search

    with progress_bar() as update:
        result = search(
            make_template(name, title, cabs),
            Limits(peak_db=peak, overshoot=overshoot / 100.0),
            form=form,
            evaluations=evaluations,
            seed=seed,
            progress=update,
        )
    command_line = (
        f"cmf tune --form {form} --peak {peak:g} --overshoot {overshoot:g} "
        f"--cabs {','.join(cabs)} --evaluations {evaluations} --seed {seed}"
    )
    law = result.law.model_copy(update={"source": f"this project: {command_line}"})
    target = save_law(law, file, f"Written by `{command_line}`.")
    reached = result.performance
    show(
        f"linear plants, worst of all cabs, degrees of freedom and valve gains: "
        f"-90 deg {reached.phase_hz.min():.2f} Hz, peak {reached.peak_db.max():.2f} dB, "
        f"overshoot {100.0 * reached.overshoot.max():.1f} %",
        f"{result.evaluations} laws tried; written to {target}",
    )


@command("calibrate")
def calibrate_command(
    tables: Annotated[
        list[str],
        argument(
            "studies.calibration.definition:load_studies",
            "[TABLES]...",
            "report, hardware, hardware_lag, or `all`",
        ),
    ] = options.ALL,
    rounds: Annotated[int, Option(help="fits, each followed by a simulation")] = 1,
    quick: options.Quick = False,
    samples: Annotated[int, Option(help="samples for the uncertainty")] = 128,
    jobs: options.Jobs = None,
    out: options.Out = Path("out/calibrate"),
) -> None:
    """Fit the free parameters to the published tables: values, residuals and uncertainty."""
    from cmf_mj.show import calibration as report
    from cmf_mj.studies.calibration.definition import load_study
    from cmf_mj.studies.calibration.fit import calibrate
    from cmf_mj.studies.calibration.sensitivity import examine

    def say(line: str) -> None:
        typer.echo(line, err=True)

    for chosen in [load_study(name) for name in tables]:
        fitted = calibrate(chosen, rounds=rounds, quick=quick, jobs=jobs, progress=say)
        result = examine(fitted, samples=samples, jobs=jobs)
        folder = out / chosen.name
        paths = report.save_calibration(result, folder)
        show(*report.tables(result), report.verdict_text(result), written(paths, folder))
