"""Table, data and figure of the cross-verification."""

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from cmf_mj.core.files import whole_file, write_csv, write_text
from cmf_mj.show.comparison import markdown
from cmf_mj.studies.verification import ENGINES, Run, Verification

_TITLES = {"mujoco": "MuJoCo", "exudyn": "Exudyn"}
_STYLES = {"mujoco": ("#0072b2", "o"), "exudyn": ("#d55e00", "s")}
_MICRO = 1e6


def _parts(run: Run) -> str:
    return f"1/{round(1.0 / run.step)}"


def cells(found: Verification) -> tuple[list[str], list[list[str]]]:
    """Header and lines, a line a run."""
    header = ["engine", "step [s]", "leg error [um]", "pressure error [Pa]", "CPU time [s]"]
    lines = [
        [
            _TITLES[run.engine],
            _parts(run),
            f"{run.extension_error * _MICRO:.4f}",
            f"{run.pressure_error:.1f}",
            f"{run.cpu_time:.2f}",
        ]
        for run in found.runs
    ]
    return header, lines


def note(found: Verification) -> str:
    """What the errors are against."""
    return (
        f"{found.cab.upper()}, {found.seconds:g} s, legs up to {found.travel * 1e3:.1f} mm from "
        f"neutral; reference good to {found.extension_uncertainty * _MICRO:.4f} um and "
        f"{found.pressure_uncertainty:.2f} Pa"
    )


def table(found: Verification) -> Table:
    """The runs as a terminal table."""
    header, lines = cells(found)
    shown = Table(title=note(found), box=SIMPLE_HEAD, title_justify="left")
    for name in header:
        shown.add_column(
            escape(name), no_wrap=True, justify="left" if name == "engine" else "right"
        )
    for line in lines:
        shown.add_row(*line)
    return shown


def _slope(axis: Axes, run: Run, last: float) -> None:
    steps = [run.step, last]
    errors = [0.5 * run.extension_error * _MICRO * (step / run.step) ** 2 for step in steps]
    axis.loglog(steps, errors, color="0.6", linestyle=":", label="order 2")


def figure(found: Verification) -> Figure:
    """Largest leg error against the step, and against the CPU time it costs."""
    drawn = Figure(figsize=(10.0, 4.4), layout="constrained")
    by_step, by_cost = drawn.subplots(1, 2, sharey=True)
    for engine in ENGINES:
        runs = [run for run in found.runs if run.engine == engine]
        colour, marker = _STYLES[engine]
        errors = [run.extension_error * _MICRO for run in runs]
        for axis, along in (
            (by_step, [run.step for run in runs]),
            (by_cost, [run.cpu_time for run in runs]),
        ):
            axis.loglog(along, errors, color=colour, marker=marker, label=_TITLES[engine])
        for run, following in zip(runs, [*runs[1:], None], strict=True):
            # Below the point where the line goes on level, beside it where it falls.
            falls = following and following.extension_error < 0.5 * run.extension_error
            by_cost.annotate(
                f"{_parts(run)} s",
                (run.cpu_time, run.extension_error * _MICRO),
                xytext=(6, 4) if falls else (0, -14),
                textcoords="offset points",
                ha="left" if falls else "center",
                fontsize=8,
            )
    first = found.runs[0]
    _slope(by_step, first, min(run.step for run in found.runs))
    steps = sorted({run.step for run in found.runs})
    by_step.set_xticks(steps, labels=[f"1/{round(1.0 / step)}" for step in steps])
    by_step.minorticks_off()
    by_step.set(xlabel="mechanical step [s]", ylabel="largest leg error [um]")
    by_cost.set(xlabel="CPU time [s]")
    by_cost.margins(x=0.15)
    for axis in (by_step, by_cost):
        axis.grid(True, color="0.9", linewidth=0.6)
    by_step.legend(fontsize=9)
    drawn.suptitle(
        f"Two engines on the same valve commands, {found.seconds:g} s, {found.cab.upper()}"
    )
    return drawn


def save(found: Verification, folder: Path) -> list[Path]:
    """Write `work_precision.png`, `work_precision.csv` (SI) and `work_precision.md`."""
    paths = [folder / f"work_precision.{kind}" for kind in ("png", "csv", "md")]
    with whole_file(paths[0]) as path:
        figure(found).savefig(path, dpi=100, format="png")
    header = ["engine", "step_s", "leg_error_m", "pressure_error_pa", "cpu_time_s"]
    write_csv(paths[1], header, found.runs)
    write_text(paths[2], markdown(*cells(found)))
    return paths
