"""What all commands share: the application, its options, printing and refusing."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import typer
from typer.core import TyperGroup

from cmf_mj.core.errors import CmfError, InputError, reason

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from rich.console import RenderableType

    from cmf_mj.electronics.chain import ElectronicsSettings
    from cmf_mj.plant.cylinder import Contact

_LONGEST_MESSAGE = 2000  #: Characters of an error that are printed: a value may be a whole file.

TEXT_WIDTH = 120  #: Least width of what is printed [characters], in narrower terminals too.


def refuse(error: Exception) -> NoReturn:
    """Print one clear error and leave with status 2."""
    message = str(error)
    if len(message) > _LONGEST_MESSAGE:
        message = f"{message[:_LONGEST_MESSAGE]} ..."
    typer.secho(f"cmf: {message}", err=True, fg=typer.colors.RED)
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
            fault = error.__cause__.errors()[0]
            allowed = fault["msg"][:1].lower() + fault["msg"][1:]
            refuse(InputError(f"{error.param.name}: {fault['input']!r} is refused: {allowed}"))
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
    from cmf_mj.core.files import exclusive_folder

    if not context.resilient_parsing:
        context.find_root().with_resource(exclusive_folder(folder))
    return folder


def given_by_user(context: typer.Context, name: str) -> bool:
    """Whether the user gave an option; true where it was not read from a command line."""
    source = context.get_parameter_source(name)
    return source is None or not source.name.startswith("DEFAULT")


def check_writable(file: Path | None) -> Path | None:
    """Refuse a file that cannot be written, before the work for it."""
    from cmf_mj.core.files import check_target

    return None if file is None else check_target(file)


def show(*parts: RenderableType, unfolded: bool = False) -> None:
    """Print tables and text `TEXT_WIDTH` wide or more; if `unfolded`, so that no cell folds."""
    from rich.console import Console

    from cmf_mj.core.result import Table

    console, width, wide_console = Console(), TEXT_WIDTH, Console(width=1000)
    if unfolded:
        widths = (wide_console.measure(part).maximum for part in parts if not isinstance(part, str))
        width = max(widths, default=TEXT_WIDTH)
    available = console.width if console.is_terminal else width
    if console.width < width:
        console = Console(width=width)
    for part in parts:
        pieces: Sequence[RenderableType] = [part]
        if isinstance(part, Table) and wide_console.measure(part).maximum > available:
            pieces = part.column_groups()  # one below the other
        for piece in pieces:
            console.print(piece, markup=not isinstance(piece, str))  # tables escape their own


def written_text(paths: Sequence[Path], folder: Path | None = None) -> str:
    """What has been written, in a line: whole paths, or names within a folder."""
    if folder is None:
        return f"written: {', '.join(str(path) for path in paths)}"
    return f"written to {folder}: {', '.join(path.name for path in paths)}"


@contextmanager
def progress_bar(
    work: str = "running", *, seconds: bool = False, compiles: bool = True
) -> Iterator[Callable[..., None]]:
    """A bar on the error stream; yields `update(done, total, now=work)`.

    Shows done of total, or with `seconds` the time elapsed; `now` is what it does now.
    """
    from rich import progress
    from rich.console import Console

    counts = (progress.MofNCompleteColumn(), progress.TimeRemainingColumn())
    columns = (progress.TimeElapsedColumn(),) if seconds else counts
    text, console = progress.TextColumn("{task.description}", markup=False), Console(stderr=True)
    with progress.Progress(text, progress.BarColumn(), *columns, console=console) as bar:
        first_text = f"{work}, compiling first takes a minute or two" if compiles else work
        task = bar.add_task(first_text, total=None)
        try:
            yield lambda done, total, now=work: bar.update(
                task, completed=done, total=total, description=now
            )
        except Exception:
            bar.live.transient = True  # an error stands alone
            raise


def quantity_option(field: str, text: str) -> tuple[float, str]:
    """A number and its unit, "1" if it has none, of text such as `1 in^2`; errors name `field`."""
    number, _, unit = text.strip().partition(" ")
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{field}: {text!r} is not a finite number and a unit, such as '0.33 in'")
    return value, unit.strip() or "1"


def amplitude_option(dof: str, text: str | None) -> float | None:
    """An amplitude of the command line, such as `3 deg`, in SI."""
    from cmf_mj.signals.signal import amplitude_in_si

    if text is None:
        return None
    value, unit = quantity_option("amplitude", text)
    if unit == "1":
        raise InputError(f"amplitude: {text!r} has no unit; such as '{text.strip()} in'")
    return amplitude_in_si(dof, (value, unit))


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
    except ValueError:
        values = []
    if len(values) != 6 or not np.isfinite(values).all():
        allowed = "six finite numbers with commas between"
        raise InputError(f"pose: {text!r} is refused; allowed: {allowed}")
    return np.array([units.to_si(dof_unit(dof), value) for dof, value in enumerate(values)])


def noise_option(noise: bool) -> ElectronicsSettings | None:
    """Noisy sensors, converters and servo electronics, or ideal ones."""
    from cmf_mj.electronics.chain import ElectronicsSettings

    return ElectronicsSettings() if noise else None
