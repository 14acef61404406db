"""Tables, figure and files of a manoeuvre that was learnt."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from cmf_mj.core import units
from cmf_mj.core.table import Table
from cmf_mj.facility.host.files import write_stream
from cmf_mj.machine.dof import by_kind
from cmf_mj.machine.geometry import DOFS
from cmf_mj.pilot.host import MOST_RATE
from cmf_mj.pilot.learning import BAND, LEAD, Array, Learning, frequencies
from cmf_mj.show import look

_SCALE = np.array([by_kind(dof, 1e3, 1.0 / units.DEGREE) for dof in DOFS])


def trial_table(learnt: Learning) -> Table:
    """Errors of each trial, and what is left of the first run's."""
    axes = [(f"{dof} [{by_kind(dof, 'mm', 'deg')}]", ".3f") for dof in DOFS]
    first, rows = learnt.trials[0], []
    for number, one in enumerate(learnt.trials):
        left = [100.0 * one.legs / first.legs, 100.0 * one.predicted / first.predicted]
        rows.append([str(number), *(one.axes * _SCALE), 1e3 * one.legs, *left, one.held])
    columns = [("legs [mm]", ".3f"), ("left [%]", ".2f"), ("linear [%]", ".2f"), ("held", "d")]
    title = f"tracking error below {BAND:g} Hz, rms; left of the first run's"
    return Table(title, ("trial", *axes, *columns), rows)


def verdict(learnt: Learning, others: Array) -> str:
    """Convergence of the linear models, the best trial, and what it left on other machines."""
    worst = learnt.learner.ratio().max(axis=1)
    left = learnt.trials[learnt.best].legs / learnt.trials[0].legs
    text = (
        f"largest singular value of Q (1 - L G): {worst[0]:.2f} of the machine that learns, "
        f"{worst.max():.2f} over machines and poses; best trial {learnt.best}: {left:.2%} left"
    )
    shares = np.percentile(others[:, 1] / others[:, 0], [0, 50, 100]) if len(others) else ()
    on = f"; on {len(others)} other machines, least, median, most: " if len(others) else ""
    return text + on + ", ".join(f"{share:.2%}" for share in shares)


def learning_figure(learnt: Learning, others: Array) -> Figure:
    """Error by trial, convergence by frequency, the error in time, other machines."""
    figure = look.new_figure(11.0, 7.0)
    (trials, ratio), (history, machines) = figure.subplots(2, 2)
    for label, name, style in (("simulated", "sensed", "o-"), ("linear", "predicted", "x--")):
        trials.semilogy([1e3 * getattr(one, name) for one in learnt.trials], style, label=label)
    trials.set(xlabel="trial", ylabel=f"legs below {BAND:g} Hz, rms as sensed [mm]")
    lines, values = frequencies(len(learnt.reference.time)), learnt.learner.ratio()
    ratio.plot(lines, values[1:].T, color=look.GREY, linewidth=0.8)
    ratio.plot(lines, values[0], label="machine that learns, mean pose (grey: others, other poses)")
    ratio.axhline(1.0, color=look.DARK, linestyle=":")
    ratio.set(xlabel="frequency [Hz]", ylabel="largest singular value of Q (1 - L G)")
    dof = int(np.argmax(learnt.trials[0].axes[:3]))
    for number, error in zip((0, learnt.best), learnt.errors, strict=True):
        time = LEAD + np.arange(len(error)) / MOST_RATE
        history.plot(time, 1e3 * error[:, dof], label=f"trial {number}", linewidth=0.9)
    history.set(xlabel="time [s]", ylabel=f"error of {DOFS[dof]} [mm]")
    for label, errors in zip(("without", "with what was learnt"), others.T, strict=True):
        machines.semilogy(1e3 * errors, "o", label=label)
    machines.set(xlabel="other machine", ylabel=f"legs below {BAND:g} Hz, rms [mm]")
    look.legend(trials, ratio, history, machines)
    figure.suptitle("Tracking error of a manoeuvre as it is learnt, and on other machines")
    return figure


def save_learning(learnt: Learning, others: Array, folder: Path) -> list[Path]:
    """Write the learnt demand `demand.csv`, `trials.csv`, `machines.csv` and `learning.png`."""
    header = ("machine", "without_m", "with_m")
    files = {
        "demand.csv": lambda path: write_stream(learnt.demand, path),
        "trials.csv": trial_table(learnt).save,
        "machines.csv": (header, ([i, *map(float, row)] for i, row in enumerate(others))),
        "learning.png": learning_figure(learnt, others),
    }
    return look.save_files(files, folder)
