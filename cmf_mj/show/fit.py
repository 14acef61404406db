"""Tables and figures of what was fitted: machines to recordings, and identified linear models.

Of a fit: what is known of each number, and the recordings beside the fitted machine.
"""

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

_SHOWN = 4.0  #: Seconds of a recording.


def figures(posterior: Posterior, rows: Sequence[StatedNumber]) -> dict[str, Figure]:
    """Figures by file name; `rows` are what is stated."""
    found = {"recordings.png": recordings(posterior)} if posterior.campaign.recordings else {}
    return found | ({"stated.png": stated(rows)} if rows else {})


def recordings(posterior: Posterior) -> Figure:
    """A few seconds of each recording held back, else of each fitted, leg 1."""
    held = bool(posterior.campaign.of(held_back=True))
    model = Model(posterior.campaign, held_back=held)
    machine, pieces = model.machine(posterior.z), model.pieces[:4]
    channel = next((name for name in pieces[0].measured if "pressure" in name), "leg_position")
    scale, unit = (1e-5, "bar") if channel != "leg_position" else (1e3, "mm")
    label = f"{channel.replace('_', ' ')} 1 [{unit}]"
    figure, rows = stack(7.0, 2.0 * len(pieces) + 1.0, *[label] * len(pieces))
    for axes, piece in zip(rows, pieces, strict=True):
        simulated = model.simulate(piece, posterior.z, machine)
        time = piece.time - piece.time[0]
        shown = time <= _SHOWN
        axes.plot(time[shown], scale * piece.measured[channel][shown, 0], label="measured")
        axes.plot(time[shown], scale * simulated[channel][shown, 0], "--", label="fitted machine")
        axes.set_title(f"{channel.replace('_', ' ')} of leg 1, {piece.name.replace('_', ' ')}")
    legend(rows[0])
    return figure


def stated(rows: Sequence[StatedNumber]) -> Figure:
    """What is stated: how far the fitted machine is off, with the spread of what is open."""
    figure = new_figure(7.5, 1.3 + 0.21 * len(rows), gridded=False)
    axes = figure.add_subplot()
    axes.axvspan(-FAR, FAR, color="0.92")
    axes.axvline(0.0, color=GREY, linewidth=0.8)
    known = [(place, one) for place, one in enumerate(rows) if np.isfinite(one.error)]
    for role, colour in (("fitted", BLUE), ("held back", ORANGE)):
        mine = [(one.error, place) for place, one in known if one.role == role]
        if mine:
            axes.plot(*zip(*mine, strict=True), "o", color=colour, label=role)
    axes.set_yticks(
        range(len(rows)), [f"{one.evidence}, {one.quantity}" for one in rows], fontsize=8
    )
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
    rows += [
        (
            *("pole", f"{pole.hertz:.3f} Hz", f"{pole.error:.3f} Hz"),
            f"damping ratio {number(pole.damping, '.3f')}",
        )
        for pole in result.box.poles()
        if pole.value.imag >= 0.0
    ]
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
