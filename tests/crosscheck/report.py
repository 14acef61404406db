"""Table, data and figure of the cross-verification."""

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from cmf_mj.core.result import Table
from cmf_mj.show.look import BLUE, GREY, ORANGE, legend, new_figure, save_files
from crosscheck.verification import ENGINES, Verification

_STYLES = {"mujoco": ("MuJoCo", BLUE, "o"), "exudyn": ("Exudyn", ORANGE, "s")}
_MICRO = 1e6


def _parts(step: float) -> str:
    return f"1/{round(1.0 / step)}"


def verification_table(result: Verification) -> Table:
    """A row a run; the title says what the errors are against."""
    title = (
        f"{result.cab.upper()}, {result.seconds:g} s, legs up to {result.travel * 1e3:.1f} mm from "
        f"neutral; reference good to {result.extension_uncertainty * _MICRO:.4f} um and "
        f"{result.pressure_uncertainty:.2f} Pa"
    )
    columns = (
        *("engine", ("step [s]", ""), ("leg error [um]", ".4f")),
        *(("pressure error [Pa]", ".1f"), ("CPU time [s]", ".2f")),
    )
    rows = [
        (_STYLES[e][0], _parts(step), error * _MICRO, pressure, time)
        for e, step, error, pressure, time in result.runs
    ]
    return Table(title, columns, rows)


def work_precision_figure(result: Verification) -> Figure:
    """Largest leg error against the step, and against the CPU time it costs."""
    figure = new_figure(10.0, 4.4)
    by_step, by_cost = figure.subplots(1, 2, sharey=True)
    for engine in ENGINES:
        runs = [run for run in result.runs if run.engine == engine]
        title, colour, marker = _STYLES[engine]
        errors = [run.extension_error * _MICRO for run in runs]
        for axis, name in ((by_step, "step"), (by_cost, "cpu_time")):
            along = [getattr(run, name) for run in runs]
            axis.loglog(along, errors, color=colour, marker=marker, label=title)
        for run, error in zip(runs, errors, strict=True):
            place: dict[str, Any] = {"xytext": (6, 4), "textcoords": "offset points"}
            by_cost.annotate(f"{_parts(run.step)} s", (run.cpu_time, error), fontsize=8, **place)
    first, steps = result.runs[0], sorted({run.step for run in result.runs})
    ends = [first.step, steps[0]]
    order_2 = [0.5 * first.extension_error * _MICRO * (step / first.step) ** 2 for step in ends]
    by_step.loglog(ends, order_2, color=GREY, linestyle=":", label="order 2")
    by_step.set_xticks(steps, labels=[_parts(step) for step in steps])
    by_step.minorticks_off()
    by_step.set(xlabel="mechanical step [s]", ylabel="largest leg error [um]")
    by_cost.set(xlabel="CPU time [s]")
    by_cost.margins(x=0.15)
    legend(figure)
    where = f"{result.seconds:g} s, {result.cab.upper()}"
    figure.suptitle(f"Two engines on the same valve commands, {where}")
    return figure


def save_verification(result: Verification, folder: Path) -> list[Path]:
    """Write `work_precision.png`, `work_precision.csv` (SI) and `work_precision.md`."""
    header = ["engine", "step_s", "leg_error_m", "pressure_error_pa", "cpu_time_s"]
    files = {
        "work_precision.png": work_precision_figure(result),
        "work_precision.csv": [dict(zip(header, run, strict=True)) for run in result.runs],
        "work_precision.md": verification_table(result),
    }
    return save_files(files, folder, 100)
