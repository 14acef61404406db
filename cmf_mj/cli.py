"""The command line, `cmf`."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, NoReturn

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from cmf_mj import identification_report, measurement_report, models, report, units
from cmf_mj.control import law_names, load_law
from cmf_mj.identification_study import (
    Method,
    Signal,
    identify,
    identify_matrix,
    simulated_records,
    simulated_step,
)
from cmf_mj.kinematics import DOFS
from cmf_mj.limits import peaks
from cmf_mj.measurement import facility_session, measure, session_commands
from cmf_mj.parameters import load_hydraulics
from cmf_mj.plant import Hexapod, Plant, SingleLegs
from cmf_mj.recording import write_facility_csv
from cmf_mj.signals import dof_index
from cmf_mj.studies import AMPLITUDE, DEFAULT_LAWS, PLANTS, Comparison, compare

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="NASA Langley's Cockpit Motion Facility: control laws on a faithful hexapod.",
)

_TEXT_WIDTH = 120
"""Width for tables that fold their text, where the terminal is narrower or there is none."""


def _print(*parts: Table | str, width: int = 0) -> None:
    """Print tables and text, never narrower than `width`."""
    console = Console()
    if console.width < width:
        console = Console(width=width)
    for part in parts:
        console.print(part)


def refuse(error: Exception) -> NoReturn:
    """Print one clear error and leave with status 2."""
    typer.secho(f"cmf: {error}", err=True, fg=typer.colors.RED)
    raise SystemExit(2)


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
) -> Comparison:
    """Compare with a progress bar, print the table and write all files to `out`."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("compiling and running", total=None)
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
            progress=lambda done, total: bar.update(
                task, completed=done, total=total, description="running"
            ),
        )
    out.mkdir(parents=True, exist_ok=True)
    comparison.save_csv(out / "comparison.csv")
    figures = report.save_figures(comparison, out)
    header, lines = report.comparison_cells(comparison.rows)
    (out / "comparison.md").write_text(report.markdown(header, lines), encoding="utf-8")
    table = report.comparison_table(comparison.rows)
    kept = ", records/" if records else ""
    gap = max(result.gimbal_error for result in comparison.results)
    _print(
        table,
        f"largest gap of a closed gimbal: {gap * 1e6:.2f} micrometres",
        f"written to {out}: comparison.csv, comparison.md, {len(figures)} figures{kept}",
        width=Console(width=1000).measure(table).maximum,
    )
    return comparison


def _names(text: str, every: tuple[str, ...]) -> list[str]:
    return list(every) if text == "all" else [part.strip() for part in text.split(",") if part]


@app.command("compare")
def compare_command(
    laws: Annotated[
        str, typer.Option(help="laws by name or TOML file, comma-separated, or `all`")
    ] = ",".join(DEFAULT_LAWS),
    dofs: Annotated[str, typer.Option(help="degrees of freedom, or `all`")] = "all",
    cab: Annotated[str, typer.Option(help="gfd, rfd or ifd")] = "gfd",
    plants: Annotated[str, typer.Option(help="hexapod, single_legs, or `all`")] = "all",
    hydraulics: Annotated[
        str, typer.Option(help="report, hardware, or a TOML file of your own")
    ] = "hardware",
    amplitude: Annotated[
        float,
        typer.Option(help="sweep amplitude [in]; rotations 0.2 deg and steps 1 in to 0.33 in"),
    ] = round(AMPLITUDE / units.INCH, 6),
    jobs: Annotated[int | None, typer.Option(help="threads; default one a core")] = None,
    out: Annotated[Path, typer.Option(help="folder for results")] = Path("out/compare"),
    quick: Annotated[bool, typer.Option("--quick", help="sweep in 30 s instead of 100 s")] = False,
    records: Annotated[
        bool, typer.Option(help="keep the records of all runs, about 8 MB a case")
    ] = True,
) -> None:
    """Compare control laws in six degrees of freedom on the hexapod and on single legs."""
    try:
        run_comparison(
            _names(laws, law_names()),
            _names(dofs, DOFS),
            _names(plants, PLANTS),
            out,
            cab=cab,
            hydraulics=hydraulics,
            amplitude=amplitude * units.INCH,
            jobs=jobs,
            quick=quick,
            records=records,
        )
    except (ValueError, OSError, FloatingPointError) as error:
        refuse(error)


def _plant(plant: str, cab: str, hydraulics: str) -> Callable[[], Plant]:
    """Builder of a plant named on the command line; refuses bad names at once."""
    if plant not in PLANTS:
        raise ValueError(f"plant: {plant!r} is not one of {', '.join(PLANTS)}")
    parameters = load_hydraulics(hydraulics)
    models.cab_path(cab)
    return lambda: Hexapod(cab, parameters) if plant == "hexapod" else SingleLegs(parameters)


def _size(dof: str, amplitude: float | None) -> float | None:
    """An amplitude of the command line, in or deg, in SI."""
    if amplitude is None:
        return None
    return units.to_si("in" if dof_index(dof) < 3 else "deg", amplitude)


Dof = Annotated[str, typer.Option(help=f"degree of freedom: {', '.join(DOFS)}")]
LawName = Annotated[str, typer.Option("--law", help="law by name or TOML file")]
PlantName = Annotated[str, typer.Option("--plant", help="hexapod or single_legs")]
Cab = Annotated[str, typer.Option(help="gfd, rfd or ifd")]
HydraulicSet = Annotated[str, typer.Option(help="report, hardware or a TOML file")]
Amplitude = Annotated[
    float | None, typer.Option(help="amplitude [in or deg]; default 0.33 in or 0.2 deg")
]


@app.command("record")
def record_command(
    law: LawName = "velocity",
    dof: Dof = "heave",
    plant: PlantName = "hexapod",
    cab: Cab = "gfd",
    hydraulics: HydraulicSet = "hardware",
    amplitude: Amplitude = None,
    jobs: Annotated[int | None, typer.Option(help="threads; default one a core")] = None,
    out: Annotated[Path, typer.Option(help="folder for the five files")] = Path("out/record"),
) -> None:
    """Run the facility's session, five rounds of seven sines, and write its five CSV files."""
    try:
        build = _plant(plant, cab, hydraulics)
        largest = [peaks(command) for command in session_commands(dof, _size(dof, amplitude))]
        index, unit = dof_index(dof), "in" if dof_index(dof) < 3 else "deg"
        velocity, acceleration = (
            units.from_si(unit, max(float(getattr(peak, kind)[index]) for peak in largest))
            for kind in ("velocity", "acceleration")
        )
        _print(f"peak demand: {velocity:.3g} {unit}/s, {acceleration:.3g} {unit}/s^2")
        session = facility_session(build, law, dof, amplitude=_size(dof, amplitude), jobs=jobs)
        for number, record in enumerate(session, start=1):
            name = f"{record.metadata['law']}_{dof}_{number}of{len(session)}.csv"
            print(write_facility_csv(record, out / name))
    except (ValueError, OSError, FloatingPointError) as error:
        refuse(error)


@app.command("measure")
def measure_command(
    files: Annotated[
        list[Path] | None,
        typer.Argument(help="recordings: facility CSV, UFF 58 or Parquet; rounds are joined"),
    ] = None,
    simulate: Annotated[
        bool, typer.Option("--simulate", help="run a whole measuring session instead")
    ] = False,
    law: LawName = "velocity",
    dof: Dof = "heave",
    plant: PlantName = "hexapod",
    cab: Cab = "gfd",
    hydraulics: HydraulicSet = "hardware",
    amplitude: Amplitude = None,
    estimator: Annotated[str, typer.Option(help="h1, h2, hv or report; one recording")] = "h1",
    out: Annotated[Path, typer.Option(help="folder for results")] = Path("out/measure"),
) -> None:
    """Measure recordings, or a simulated session, in the field's terms."""
    try:
        if simulate == bool(files):
            raise ValueError("files: name recordings, or use --simulate, not both and not neither")
        if simulate:
            build = _plant(plant, cab, hydraulics)
            measured = measure(build, law, dof, amplitude=_size(dof, amplitude))
            paths = measurement_report.save_measurement(measured, out)
            table = measurement_report.measurement_table(measured)
        else:
            paths, table = measurement_report.measure_files(files or [], dof, estimator, out)
        _print(table, f"written: {', '.join(str(path) for path in paths)}", width=_TEXT_WIDTH)
    except (ValueError, OSError, FloatingPointError, ModuleNotFoundError) as error:
        refuse(error)


@app.command("identify")
def identify_command(
    files: Annotated[
        list[Path] | None,
        typer.Argument(help="recordings: facility CSV, UFF 58 or Parquet; the last one validates"),
    ] = None,
    simulate: Annotated[
        bool, typer.Option("--simulate", help="identify from simulated runs instead")
    ] = False,
    law: Annotated[
        str | None, typer.Option(help="law by name or TOML file; default velocity, or the file's")
    ] = None,
    dof: Annotated[
        str, typer.Option(help="degree of freedom; leg_1 to leg_6 of files; all")
    ] = "heave",
    plant: PlantName = "hexapod",
    cab: Cab = "gfd",
    hydraulics: HydraulicSet = "hardware",
    amplitude: Amplitude = None,
    signal: Annotated[
        Signal, typer.Option(help="what the simulated machine is excited with")
    ] = "multisine",
    method: Annotated[
        Method, typer.Option(help="least squares, instruments or output error")
    ] = "oe",
    orders: Annotated[
        str | None, typer.Option(help="na,nb,nk; default by validation fit on a grid")
    ] = None,
    out: Annotated[Path, typer.Option(help="folder for results")] = Path("out/identify"),
) -> None:
    """Identify a linear model of leg velocity per valve command, or of all dofs (--dof all)."""
    try:
        if simulate == bool(files):
            raise ValueError("files: name recordings, or use --simulate, not both and not neither")
        chosen = identification_report.parse_orders(orders)
        build = _plant(plant, cab, hydraulics)
        name = law or "velocity"
        if dof == "all":
            if not simulate:
                raise ValueError("dof: all needs --simulate")
            _print(identification_report.matrix_table(identify_matrix(build, name)), width=100)
            return
        if simulate:
            records = simulated_records(build, name, dof, signal, _size(dof, amplitude))
            step = simulated_step(build, name, dof, _size(dof, amplitude))
            found = identify(records, dof, method=method, orders=chosen, law=name, step=step)
        else:
            found = identification_report.identify_files(
                files or [], dof, method=method, orders=chosen, law=law
            )
        paths = identification_report.save_identification(found, out)
        tables = (
            identification_report.orders_table(found),
            identification_report.model_table(found),
        )
        _print(*tables, f"written: {', '.join(str(path) for path in paths)}", width=_TEXT_WIDTH)
    except (ValueError, OSError, FloatingPointError, ModuleNotFoundError) as error:
        refuse(error)


@app.command("laws")
def laws_command() -> None:
    """List the shipped control laws with their sources."""
    _print(report.law_table([load_law(name) for name in law_names()]), width=_TEXT_WIDTH)


@app.command("parameters")
def parameters_command(
    hydraulics: Annotated[str, typer.Argument(help="report, hardware or a TOML file")] = "hardware",
) -> None:
    """Show a hydraulic parameter set: value, unit, status and source of every number."""
    try:
        _print(report.parameter_table(load_hydraulics(hydraulics)), width=_TEXT_WIDTH)
    except ValueError as error:
        refuse(error)


def main() -> None:
    """Entry point of the `cmf` command."""
    app(prog_name="cmf")


if __name__ == "__main__":
    main()
