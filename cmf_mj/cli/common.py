"""What all commands share: the application, its options, printing and refusing."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated, NoReturn

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.machine import models
from cmf_mj.machine.dof import dof_unit
from cmf_mj.machine.kinematics import DOFS
from cmf_mj.plant.build import PLANTS, make_plant
from cmf_mj.plant.parameters.loading import load_hydraulics
from cmf_mj.plant.plant import Plant

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    help="NASA Langley's Cockpit Motion Facility: control laws on a faithful hexapod.",
)

TEXT_WIDTH = 120
"""Width for tables that fold their text, where the terminal is narrower or there is none."""


def show(*parts: RenderableType, width: int = 0) -> None:
    """Print tables and text, never narrower than `width`."""
    console = Console()
    if console.width < width:
        console = Console(width=width)
    for part in parts:
        console.print(part)


def written(paths: Sequence[Path], folder: Path | None = None) -> str:
    """What has been written, in a line: whole paths, or names within a folder."""
    if folder is None:
        return f"written: {', '.join(str(path) for path in paths)}"
    return f"written to {folder}: {', '.join(path.name for path in paths)}"


def refuse(error: Exception) -> NoReturn:
    """Print one clear error and leave with status 2."""
    typer.secho(f"cmf: {error}", err=True, fg=typer.colors.RED)
    raise SystemExit(2)


@contextmanager
def progress_bar() -> Iterator[Callable[[int, int], None]]:
    """A bar on the error stream; call what it gives with (done, in all)."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("compiling and running", total=None)
        yield lambda done, total: bar.update(
            task, completed=done, total=total, description="running"
        )


def names_of(text: str, every: tuple[str, ...]) -> list[str]:
    """Names of a comma-separated option, or all."""
    return list(every) if text == "all" else [part.strip() for part in text.split(",") if part]


def plant_builder(plant: str, cab: str, hydraulics: str) -> Callable[[], Plant]:
    """Builder of a plant named on the command line; refuses bad names at once."""
    if plant not in PLANTS:
        raise InputError(f"plant: {plant!r} is not one of {', '.join(PLANTS)}")
    models.cab_path(cab)
    return partial(make_plant, plant, cab, load_hydraulics(hydraulics))


def in_si(dof: str, amplitude: float | None) -> float | None:
    """An amplitude of the command line, in or deg, in SI."""
    if amplitude is None:
        return None
    return units.to_si(dof_unit(dof), amplitude)


def pose_option(text: str) -> NDArray[np.float64]:
    """A pose of the command line, six numbers in in and deg, in SI.

    Raises:
        InputError: not six numbers.
    """
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError as error:
        raise InputError(f"pose: {text!r} must be six numbers with commas between") from error
    if len(values) != len(DOFS):
        raise InputError(f"pose: {text!r} has {len(values)} numbers; six are needed")
    return np.array([units.to_si(dof_unit(i), v) for i, v in enumerate(values)])


def noise_choice(noise: bool) -> ElectronicsSettings | None:
    """Noisy sensors, converters and servo electronics, or ideal ones."""
    return ElectronicsSettings() if noise else None


Dof = Annotated[str, typer.Option(help=f"degree of freedom: {', '.join(DOFS)}")]
LawName = Annotated[str, typer.Option("--law", help="law by name or TOML file")]
PlantName = Annotated[str, typer.Option("--plant", help="hexapod or single_legs")]
Cab = Annotated[str, typer.Option(help="gfd, rfd or ifd")]
HydraulicSet = Annotated[str, typer.Option(help="report, hardware, lossy or a TOML file")]
Jobs = Annotated[int | None, typer.Option(help="threads; default one a core")]
StreamFile = Annotated[Path, typer.Argument(help="CSV or Parquet with time and six poses, SI")]
FrameRate = Annotated[
    float | None, typer.Option(help="frames a second; default as stamped in the file")
]
Derivatives = Annotated[
    str, typer.Option(help="velocities of a file that has none: spline or zero")
]
Amplitude = Annotated[
    float | None, typer.Option(help="amplitude [in or deg]; default 0.33 in or 0.2 deg")
]
Fps = Annotated[int, typer.Option(help="of a film: pictures a second")]
Speed = Annotated[float, typer.Option(help="times real speed; below 1 is slow motion")]
Camera = Annotated[str, typer.Option(help="of a film: overview, side or front")]
Width = Annotated[int, typer.Option(help="of the picture of one run, pixels")]
Height = Annotated[int, typer.Option(help="of the picture of one run, pixels")]
Start = Annotated[float, typer.Option(help="of a film: time of the run it begins at [s]")]
Seconds = Annotated[
    float | None, typer.Option(help="of a film: time of the run it shows; default to the end")
]
StripHeight = Annotated[
    int, typer.Option("--strip", help="height of the traces, pixels; 0 for none")
]
Noise = Annotated[
    bool,
    typer.Option(
        "--noise/--ideal", help="noisy sensors, converters and servo electronics, or ideal ones"
    ),
]
