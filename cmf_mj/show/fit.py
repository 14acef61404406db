"""Figures of machines fitted to recordings; table and files of identified linear models."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from cmf_mj.analysis.identification import Identified
from cmf_mj.core.result import Table, number
from cmf_mj.show import look
from cmf_mj.show.look import BLUE, GREY, ORANGE, legend, new_figure, stack
from cmf_mj.studies.fit.doubt import FAR, StatedNumber
from cmf_mj.studies.fit.engine import Posterior
from cmf_mj.studies.fit.model import Model

_SHOWN_SECONDS = 4.0  #: From the start of a recording.
_SHOWN_PIECES = 4  #: Recordings in the figure.


def fit_figures(posterior: Posterior, statements: Sequence[StatedNumber]) -> dict[str, Figure]:
    """Figures of a fit by file name."""
    figures = dict[str, Figure]()
    if posterior.campaign.recordings:
        figures["recordings.png"] = recording_figure(posterior)
    if statements:
        figures["stated.png"] = statement_figure(statements)
    return figures


def recording_figure(posterior: Posterior) -> Figure:
    """Leg 1 in the first seconds of recordings held back, or of fitted ones where none is."""
    held_back = bool(posterior.campaign.recordings_where(held_back=True))
    model = Model(posterior.campaign, held_back=held_back)
    machine, pieces = model.plant_at(posterior.z), model.pieces[:_SHOWN_PIECES]
    channel = next((name for name in pieces[0].measured if "pressure" in name), "leg_position")
    scale, unit = (1e-5, "bar") if channel != "leg_position" else (1e3, "mm")
    name = channel.replace("_", " ")
    figure, panels = stack(7.0, 2.0 * len(pieces) + 1.0, *[f"{name} 1 [{unit}]"] * len(pieces))
    for axes, piece in zip(panels, pieces, strict=True):
        simulated = model.simulate(piece, posterior.z, machine)
        time = piece.time - piece.time[0]
        is_shown = time <= _SHOWN_SECONDS
        measured, fitted = (
            history[channel][is_shown, 0] for history in (piece.measured, simulated)
        )
        axes.plot(time[is_shown], scale * measured, label="measured")
        axes.plot(time[is_shown], scale * fitted, "--", label="fitted machine")
        axes.set_title(f"{name} of leg 1, {piece.name.replace('_', ' ')}")
    legend(panels[0])
    return figure


def statement_figure(statements: Sequence[StatedNumber]) -> Figure:
    """Distance of the fitted machine from each statement, over the statement's deviation."""
    figure = new_figure(7.5, 1.3 + 0.21 * len(statements), gridded=False)
    axes = figure.add_subplot()
    axes.axvspan(-FAR, FAR, color="0.92")
    axes.axvline(0.0, color=GREY, linewidth=0.8)
    for role, colour in (("fitted", BLUE), ("held back", ORANGE)):
        rows = [
            row
            for row, statement in enumerate(statements)
            if statement.role == role and np.isfinite(statement.error)
        ]
        if rows:
            errors = [statements[row].error for row in rows]
            axes.plot(errors, rows, "o", color=colour, label=role)
    titles = [f"{statement.evidence}, {statement.quantity}" for statement in statements]
    axes.set_yticks(range(len(titles)), titles, fontsize=8)
    axes.invert_yaxis()
    axes.set(xlabel="fitted machine less what is stated [deviations]")
    axes.set_title("What is stated of the machine")
    legend(axes)
    return figure


def model_table(result: Identified) -> Table:
    """Fits, and poles with standard errors."""
    rows = [
        ("fit, estimation", f"{result.estimation_fit:.2f} %", "", ""),
        ("fit, validation", f"{result.validation_fit:.2f} %", "", "NRMSE, simulated"),
    ]
    for pole in result.box.poles():
        if pole.value.imag >= 0.0:
            damping = f"damping ratio {number(pole.damping, '.3f')}"
            rows.append(("pole", f"{pole.hertz:.3f} Hz", f"{pole.error:.3f} Hz", damping))
    misfit = f"{100.0 * result.continuous.misfit:.2f} %"
    rows.append(("continuous model", misfit, "", "misfit to the discrete"))
    title = f"{result.axis}: ARX, orders {tuple(result.box.orders)}"
    return Table(title, ("quantity", "value", "standard error", "note"), rows)


def save_identification(result: Identified, folder: Path) -> list[Path]:
    """Write `model.json` and `bode.png`."""
    box, velocity, response = result.box, result.continuous.velocity.to_si(), result.response
    highest = 0.4 / box.step if response is None else float(response.frequency[-1])
    curves = {"ARX": box.response(np.geomspace(0.1, min(highest, 0.45 / box.step), 300))}
    curves |= {} if response is None else {"measured": response}
    title = f"Frequency response, {' to '.join(box.names)}".replace("_", " ")
    files = {
        "model.json": {
            "axis": result.axis,
            "estimation_fit": result.estimation_fit,
            "validation_fit": result.validation_fit,
            **vars(box),
            "denominator": box.denominator,
            "numerator": box.numerator,
            "stable": box.stable,
            "continuous": {
                "numerator": velocity.num[0][0],
                "denominator": velocity.den[0][0],
                "misfit": result.continuous.misfit,
            },
        },
        "bode.png": look.bode_figure(title, curves, bounds=True)[0],
    }
    return look.save_files(files, folder)
