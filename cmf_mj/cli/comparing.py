"""`cmf compare`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from cmf_mj.cli.common import (
    HydraulicSet,
    Jobs,
    Noise,
    app,
    names_of,
    noise_choice,
    progress_bar,
    refuse,
    show,
)
from cmf_mj.control.law import law_names
from cmf_mj.core import units
from cmf_mj.machine.kinematics import DOFS
from cmf_mj.plant.build import PLANTS
from cmf_mj.show.comparison import comparison_table, save_comparison
from cmf_mj.studies.comparison import AMPLITUDE, DEFAULT_LAWS, Comparison, compare


def run_comparison(
    laws: list[str],
    dofs: list[str],
    plants: list[str],
    out: Path,
    *,
    cab: str = "gfd",
    hydraulics: str = "hardware",
    amplitude: float = AMPLITUDE,
    jobs: int | None = None,
    quick: bool = False,
    records: bool = True,
    noise: bool = False,
) -> Comparison:
    """Compare with a progress bar, print the table and write all files to `out`."""
    with progress_bar() as update:
        comparison = compare(
            laws,
            dofs,
            plants=plants,
            cab=cab,
            hydraulics=hydraulics,
            amplitude=amplitude,
            jobs=jobs,
            quick=quick,
            records=out / "records" if records else None,
            electronics=noise_choice(noise),
            progress=update,
        )
    paths = save_comparison(comparison, out)
    table = comparison_table(comparison.rows)
    kept = ", records/" if records else ""
    gap = max(result.gimbal_error for result in comparison.results)
    show(
        table,
        f"largest gap of a closed gimbal: {gap * 1e6:.2f} micrometres",
        f"written to {out}: comparison.csv, comparison.md, {len(paths) - 2} figures{kept}",
        width=Console(width=1000).measure(table).maximum,
    )
    return comparison


@app.command("compare")
def compare_command(
    laws: Annotated[
        str, typer.Option(help="laws by name or TOML file, comma-separated, or `all`")
    ] = ",".join(DEFAULT_LAWS),
    dofs: Annotated[str, typer.Option(help="degrees of freedom, or `all`")] = "all",
    cab: Annotated[str, typer.Option(help="gfd, rfd or ifd")] = "gfd",
    plants: Annotated[str, typer.Option(help="hexapod, single_legs, or `all`")] = "all",
    hydraulics: HydraulicSet = "hardware",
    amplitude: Annotated[
        float,
        typer.Option(help="sweep amplitude [in]; rotations 0.2 deg and steps 1 in to 0.33 in"),
    ] = round(AMPLITUDE / units.INCH, 6),
    jobs: Jobs = None,
    out: Annotated[Path, typer.Option(help="folder for results")] = Path("out/compare"),
    quick: Annotated[bool, typer.Option("--quick", help="sweep in 30 s instead of 100 s")] = False,
    records: Annotated[
        bool, typer.Option(help="keep the records of all runs, about 8 MB a case")
    ] = True,
    noise: Noise = False,
) -> None:
    """Compare control laws in six degrees of freedom on the hexapod and on single legs."""
    try:
        run_comparison(
            names_of(laws, law_names()),
            names_of(dofs, DOFS),
            names_of(plants, PLANTS),
            out,
            cab=cab,
            hydraulics=hydraulics,
            amplitude=amplitude * units.INCH,
            jobs=jobs,
            quick=quick,
            records=records,
            noise=noise,
        )
    except (ValueError, OSError, FloatingPointError) as error:
        refuse(error)
