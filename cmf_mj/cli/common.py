"""What all commands share: the application, its options, printing and refusing."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import typer
from typer.core import TyperGroup

from cmf_mj.core.errors import CmfError, InputError, check_name, reason

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from rich.console import RenderableType

    from cmf_mj.electronics.chain import ElectronicsSettings
    from cmf_mj.plant.cylinder import Contact

_SAID = 2000  # characters of an error, in which a refused value may be a whole file

TEXT_WIDTH = 120
"""Width for tables that fold their text, where the terminal is narrower or there is none."""


def refuse(error: Exception) -> NoReturn:
    """Print one clear error and leave with status 2."""
    said = str(error)
    said = said if len(said) <= _SAID else f"{said[:_SAID]} ..."
    typer.secho(f"cmf: {said}", err=True, fg=typer.colors.RED)
    raise SystemExit(2)


class Commands(TyperGroup):
    """Commands whose errors of use are one line; a defect keeps its traceback."""

    def invoke(self, ctx: Any) -> Any:
        """Run a command."""
        try:
            return super().invoke(ctx)
        except typer.BadParameter as error:
            from pydantic import ValidationError

            if not isinstance(error.__cause__, ValidationError) or error.param is None:
                raise
            first = error.__cause__.errors()[0]
            allowed = first["msg"][0].lower() + first["msg"][1:]
            refuse(InputError(f"{error.param.name}: {first['input']!r} is refused: {allowed}"))
        except (CmfError, OSError) as error:
            refuse(error)
        except RuntimeError as error:
            if "MUJOCO_GL" not in str(error):
                raise
            refuse(InputError(f"{error}; allowed: egl, osmesa, glfw or off"))
        except MemoryError as error:
            refuse(InputError(f"not enough memory: {reason(error)}"))


app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    help="NASA Langley's Cockpit Motion Facility: control laws on a faithful hexapod.",
)


def claim(context: typer.Context, folder: Path) -> Path:
    """Keep the folder of results for this run until the command ends, however it ends."""
    from cmf_mj.core.files import claimed

    if not context.resilient_parsing:
        context.find_root().with_resource(claimed(folder))
    return folder


def explicit(context: typer.Context, name: str) -> bool:
    """Whether an option was given and is not its default."""
    given = context.get_parameter_source(name)
    return given is None or not given.name.startswith("DEFAULT")


def target(file: Path | None) -> Path | None:
    """Refuse a file that cannot be written, before the work for it."""
    from cmf_mj.core.files import check_target

    return None if file is None else check_target(file)


def show(*parts: RenderableType, unfolded: bool = False) -> None:
    """Print tables and text, never narrower than a line, or so wide that no cell is folded.

    In a terminal that is narrower than a table, its groups of columns come one below the other.
    """
    from rich.console import Console

    console, width = Console(), TEXT_WIDTH
    if unfolded:
        tables = [part for part in parts if not isinstance(part, str)]
        width = max(Console(width=1000).measure(table).maximum for table in tables)
    room = console.width if console.is_terminal else width
    if console.width < width:
        console = Console(width=width)
    apart: list[RenderableType] = []
    for part in parts:
        split = getattr(part, "parts", None)
        narrow = split is not None and Console(width=1000).measure(part).maximum > room
        apart += split() if narrow and split else [part]
    for part in apart:
        console.print(part, markup=not isinstance(part, str))  # tables escape their own


def written(paths: Sequence[Path], folder: Path | None = None) -> str:
    """What has been written, in a line: whole paths, or names within a folder."""
    if folder is None:
        return f"written: {', '.join(str(path) for path in paths)}"
    return f"written to {folder}: {', '.join(path.name for path in paths)}"


@contextmanager
def progress_bar(work: str = "running", *, seconds: bool = False) -> Iterator[Callable[..., None]]:
    """A bar on the error stream; call what it gives with (done, in all): cases, or `seconds`.

    A third argument is what it does now.
    """
    from rich import progress
    from rich.console import Console

    counts = (progress.MofNCompleteColumn(), progress.TimeRemainingColumn())
    columns = (progress.TimeElapsedColumn(),) if seconds else counts
    text, console = progress.TextColumn("{task.description}", markup=False), Console(stderr=True)
    with progress.Progress(text, progress.BarColumn(), *columns, console=console) as bar:
        first = "" if work == "drawing" else ", the first time after a minute or two of compiling"
        task = bar.add_task(work + first, total=None)
        try:
            yield lambda done, total, now=work: bar.update(
                task, completed=done, total=total, description=now
            )
        except Exception:
            bar.live.transient = True  # an error stands alone
            raise


def quantity(field: str, text: str) -> tuple[float, str]:
    """A number and its unit, such as `1 in^2`; `field` is its name in errors."""
    number, _, unit = text.strip().partition(" ")
    try:
        return float(number), unit.strip() or "1"
    except ValueError:
        message = f"{field}: {text!r} is not a number and a unit, such as '0.33 in'"
        raise InputError(message) from None


def in_si(dof: str, amplitude: str | None) -> float | None:
    """An amplitude of the command line, such as `3 deg`, in SI."""
    from cmf_mj.core import units
    from cmf_mj.machine.geometry import by_kind

    if amplitude is None:
        return None
    value, unit = quantity("amplitude", amplitude)
    if unit == "1":
        raise InputError(f"amplitude: {amplitude!r} has no unit; such as '{amplitude.strip()} in'")
    check_name("amplitude: unit", unit, by_kind(dof, ("in", "m", "mm"), ("deg", "rad")))
    return units.to_si(unit, value)


def friction_option(text: str | None) -> Contact | None:
    """Dry friction of the command line: a word, or the speed of sliding legs [m/s]."""
    try:
        return None if text is None else float(text)
    except ValueError:
        return text  # type: ignore[return-value]  # what uses it refuses other words


def pose_option(text: str) -> NDArray[np.float64]:
    """A pose of the command line, six numbers in in and deg, in SI."""
    import numpy as np

    from cmf_mj.core import units
    from cmf_mj.machine.geometry import dof_unit

    try:
        values = [float(part) for part in text.split(",")]
    except ValueError as error:
        raise InputError(f"pose: {text!r} must be six numbers with commas between") from error
    if len(values) != 6:
        raise InputError(f"pose: {text!r} has {len(values)} numbers; six are needed")
    return np.array([units.to_si(dof_unit(i), v) for i, v in enumerate(values)])


def noise_choice(noise: bool) -> ElectronicsSettings | None:
    """Noisy sensors, converters and servo electronics, or ideal ones."""
    from cmf_mj.electronics.chain import ElectronicsSettings

    return ElectronicsSettings() if noise else None
