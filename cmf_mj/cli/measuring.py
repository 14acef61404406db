"""`cmf record` and `cmf measure`."""

from pathlib import Path
from typing import Annotated

import typer

from cmf_mj.cli.common import (
    TEXT_WIDTH,
    Amplitude,
    Cab,
    Dof,
    HydraulicSet,
    Jobs,
    LawName,
    Noise,
    PlantName,
    app,
    in_si,
    noise_choice,
    plant_builder,
    refuse,
    show,
    written,
)
from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.machine.dof import dof_index, dof_unit
from cmf_mj.record.writer import write_facility_csv
from cmf_mj.show import measurement as measurement_report
from cmf_mj.signals.peaks import peaks
from cmf_mj.studies.measurement import facility_session, measure, session_commands
from cmf_mj.studies.recordings import measure_recordings


@app.command("record")
def record_command(
    law: LawName = "velocity",
    dof: Dof = "heave",
    plant: PlantName = "hexapod",
    cab: Cab = "gfd",
    hydraulics: HydraulicSet = "hardware",
    amplitude: Amplitude = None,
    noise: Noise = False,
    jobs: Jobs = None,
    out: Annotated[Path, typer.Option(help="folder for the five files")] = Path("out/record"),
) -> None:
    """Run the facility's session, five rounds of seven sines, and write its five CSV files."""
    try:
        build = plant_builder(plant, cab, hydraulics)
        largest = [peaks(command) for command in session_commands(dof, in_si(dof, amplitude))]
        index, unit = dof_index(dof), dof_unit(dof)
        velocity, acceleration = (
            units.from_si(unit, max(float(getattr(peak, kind)[index]) for peak in largest))
            for kind in ("velocity", "acceleration")
        )
        show(f"peak demand: {velocity:.3g} {unit}/s, {acceleration:.3g} {unit}/s^2")
        session = facility_session(
            build,
            law,
            dof,
            amplitude=in_si(dof, amplitude),
            electronics=noise_choice(noise),
            jobs=jobs,
        )
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
    noise: Noise = False,
    estimator: Annotated[str, typer.Option(help="h1, h2, hv or report; one recording")] = "h1",
    out: Annotated[Path, typer.Option(help="folder for results")] = Path("out/measure"),
) -> None:
    """Measure recordings, or a simulated session, in the field's terms."""
    try:
        if simulate == bool(files):
            raise InputError("files: name recordings, or use --simulate, not both and not neither")
        if simulate:
            build = plant_builder(plant, cab, hydraulics)
            measured = measure(
                build,
                law,
                dof,
                amplitude=in_si(dof, amplitude),
                electronics=noise_choice(noise),
            )
            paths = measurement_report.save_measurement(measured, out)
            table = measurement_report.measurement_table(measured)
        else:
            measures = measure_recordings(files or [], dof, estimator)
            paths = measurement_report.save_recordings(measures, out)
            table = measurement_report.recordings_table(measures)
        show(table, written(paths), width=TEXT_WIDTH)
    except (ValueError, OSError, FloatingPointError, ModuleNotFoundError) as error:
        refuse(error)
