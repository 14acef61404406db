"""`cmf run`."""

import json
from pathlib import Path
from typing import Annotated

import typer

from cmf_mj.cli.common import app, progress_bar, refuse, show, written
from cmf_mj.facility.scenario.library import load_scenario, scenario_names
from cmf_mj.facility.scenario.run import run_scenario
from cmf_mj.facility.scenario.settings import Scenario
from cmf_mj.show import scenario as scenario_report


@app.command("run")
def run_command(
    scenario: Annotated[
        str, typer.Argument(help="TOML file, or a shipped one by name; without: their list")
    ] = "",
    out: Annotated[
        Path | None, typer.Option(help="folder for results; default out/run/NAME")
    ] = None,
    schema: Annotated[
        bool, typer.Option("--schema", help="print the JSON schema of a scenario and end")
    ] = False,
) -> None:
    """Run a scenario: plant, law, signals, failures and changes from one file."""
    try:
        if schema:
            print(json.dumps(Scenario.model_json_schema(), indent=2))
            return
        if not scenario:
            for name in scenario_names():
                show(f"{name:24} {load_scenario(name).title}")
            return
        chosen = load_scenario(scenario)
        with progress_bar() as progress:
            record = run_scenario(chosen, progress=progress)
        folder = out or Path("out/run") / Path(scenario).stem
        with progress_bar() as progress:
            paths = scenario_report.save_run(record, chosen, folder, progress=progress)
        show(written(paths))
    except (ValueError, OSError, FloatingPointError) as error:
        refuse(error)
