"""`cmf linear`, `cmf sensors` and `cmf replay`."""

from pathlib import Path
from typing import Annotated

import typer

from cmf_mj.cli.common import TEXT_WIDTH, LawName, app, names_of, refuse, show, written
from cmf_mj.control.law import law_names
from cmf_mj.electronics.sensors.settings import load_sensors
from cmf_mj.facility.replay import law_of, replay
from cmf_mj.record.reader import read_recording
from cmf_mj.show import linear as linear_report
from cmf_mj.show import sensor as sensor_report
from cmf_mj.show.listing import sensor_table
from cmf_mj.studies.accelerometer_filter import filter_effect


@app.command("linear")
def linear_command(
    laws: Annotated[
        str, typer.Option(help="laws around the hardware models, or `all`")
    ] = "velocity",
    out: Annotated[Path, typer.Option(help="folder for results")] = Path("out/linear"),
) -> None:
    """Show the report's linear models, Table 4-1 beside its computation, section 3.4's analysis."""
    try:
        show(*linear_report.linear_command(names_of(laws, law_names()), out), width=TEXT_WIDTH)
    except (ValueError, OSError) as error:
        refuse(error)


@app.command("sensors")
def sensors_command(
    sensors: Annotated[str, typer.Argument(help="ideal, noisy or a TOML file")] = "noisy",
    law: LawName = "acceleration_opposing",
    seed: Annotated[int, typer.Option(help="of the noise")] = 0,
    out: Annotated[Path, typer.Option(help="folder for the figures")] = Path("out/sensors"),
) -> None:
    """Show a sensor set, and what the accelerometer filter does to it (Figures 3-15, 3-16)."""
    try:
        settings = load_sensors(sensors)
        effect = filter_effect(settings, law, seed=seed)
        paths = sensor_report.save_sensor_figures(effect, out)
        tables = (sensor_table(settings), sensor_report.effect_table(effect))
        show(*tables, written(paths), width=TEXT_WIDTH)
    except (ValueError, OSError, FloatingPointError) as error:
        refuse(error)


@app.command("replay")
def replay_command(
    recording: Annotated[Path, typer.Argument(help="Parquet, facility CSV or UFF 58")],
    law: Annotated[
        str | None, typer.Option(help="law by name or TOML file; default the recording's")
    ] = None,
    out: Annotated[Path, typer.Option(help="folder for the figure")] = Path("out/replay"),
) -> None:
    """Run the control law open loop on recorded feedback; compare the compensator's output."""
    try:
        record = read_recording(recording)
        replayed = replay(record, law or law_of(record))
        path = sensor_report.save_replay(replayed, out / f"{recording.stem}_{replayed.law}.png")
        show(sensor_report.replay_summary(replayed), f"written: {path}")
    except (ValueError, OSError, ModuleNotFoundError) as error:
        refuse(error)
