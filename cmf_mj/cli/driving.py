"""`cmf studio`."""

import signal
import time
import warnings
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from cmf_mj.cli.common import app, refuse
from cmf_mj.facility.scenario.library import load_scenario


@app.command("studio")
def studio_command(
    scenario: Annotated[
        Path | None, typer.Argument(help="scenario file each tab begins with")
    ] = None,
    host: Annotated[str, typer.Option(help="address to listen on")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="TCP port; the next free one if it is taken")] = 8048,
    show: Annotated[
        bool, typer.Option("--open/--no-open", help="whether to open the page in a browser")
    ] = True,
) -> None:
    """Drive the machine in a web page, in real time."""
    try:
        from cmf_mj.show.studio.server import Studio
    except ModuleNotFoundError as error:
        if error.name not in ("viser", "mjviser"):
            raise
        refuse(
            ModuleNotFoundError(
                f"{error.name} is not installed; the studio needs it: install cmf-mj[studio]"
            )
        )
    # A picture on its way to a tab that has just been closed is nothing to tell of.
    warnings.filterwarnings("ignore", message="Queued a .* on a closed connection")
    try:
        begun = None if scenario is None else load_scenario(scenario)
        studio = Studio(host, port, begun)
    except (ValueError, OSError) as error:
        refuse(error)
    # A shell that starts it in the background would have it ignore Ctrl-C for good.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    print(f"studio: {studio.url} (end with Ctrl-C)", flush=True)
    if show:
        webbrowser.open(studio.url)
    try:
        while True:
            time.sleep(1.0)
    except KeyboardInterrupt:
        pass
    finally:
        studio.stop()
