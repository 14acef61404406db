"""`cmf study` and `cmf ablation`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from cmf_mj.cli.common import TEXT_WIDTH, app, progress_bar, refuse, show, written
from cmf_mj.show import study as study_report
from cmf_mj.studies.engine import Backend, run_study
from cmf_mj.studies.settings import load_study, ready_studies

Jobs = Annotated[int, typer.Option(help="processes or threads")]
Laws = Annotated[str | None, typer.Option(help="laws instead of the study's, by name or TOML file")]
Workers = Annotated[Backend, typer.Option(help="threading, loky (processes) or dask")]
Address = Annotated[str | None, typer.Option(help="address of a running Dask scheduler")]


def _run(
    specification: str,
    out: Path,
    *,
    laws: str | None,
    jobs: int,
    backend: Backend,
    scheduler: str | None,
    changes: dict[str, Any],
) -> None:
    try:
        study = load_study(
            specification,
            laws=None if laws is None else [part.strip() for part in laws.split(",")],
            changes={name: value for name, value in changes.items() if value is not None},
        )
        with progress_bar() as update:
            table = run_study(
                study,
                out,
                jobs=jobs,
                backend="dask" if scheduler else backend,
                scheduler=scheduler,
                progress=update,
            )
        paths = study_report.save_report(table, out)
        show(
            study_report.summary_table(table),
            written(paths, out),
            width=TEXT_WIDTH,
        )
    except KeyboardInterrupt:
        typer.secho(f"cmf: interrupted; the same command goes on with {out}", err=True)
        raise SystemExit(130) from None
    except (ValueError, OSError, ModuleNotFoundError) as error:
        refuse(error)


@app.command("study")
def study_command(
    specification: Annotated[
        str, typer.Argument(help=", ".join((*ready_studies(), "or a TOML file")))
    ],
    out: Annotated[Path | None, typer.Option(help="folder; default out/NAME")] = None,
    laws: Laws = None,
    draws: Annotated[int | None, typer.Option(help="machines drawn")] = None,
    jobs: Jobs = 1,
    backend: Workers = "loky",
    scheduler: Address = None,
) -> None:
    """Run a study of many cases, or what is left of it; the same command resumes it."""
    _run(
        specification,
        out if out is not None else Path("out") / Path(specification).stem,
        laws=laws,
        jobs=jobs,
        backend=backend,
        scheduler=scheduler,
        changes={"draws": draws},
    )


@app.command("ablation")
def ablation_command(
    out: Annotated[Path, typer.Option(help="folder")] = Path("out/ablation"),
    laws: Laws = None,
    dofs: Annotated[str | None, typer.Option(help="degrees of freedom")] = None,
    jobs: Jobs = 1,
    backend: Workers = "loky",
    scheduler: Address = None,
) -> None:
    """Climb from a single leg to the whole machine, one effect at a time."""
    _run(
        "ablation",
        out,
        laws=laws,
        jobs=jobs,
        backend=backend,
        scheduler=scheduler,
        changes={"dofs": None if dofs is None else [part.strip() for part in dofs.split(",")]},
    )
