"""Figures of a fit: what is known of each number, and the recordings beside the fitted machine."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from scipy import stats

from cmf_mj.show.look import BLUE, GREY, ORANGE, legend, new_figure, stack
from cmf_mj.studies.fit.engine import Posterior
from cmf_mj.studies.fit.model import Model
from cmf_mj.studies.fit.stated import FAR, Stated

_SHOWN = 4.0  #: Seconds of a recording.


def figures(posterior: Posterior, rows: Sequence[Stated]) -> dict[str, Figure]:
    """Figures by file name; `rows` are what is stated."""
    found = {"numbers.png": numbers(posterior)}
    if posterior.campaign.recordings:
        found["recordings.png"] = recordings(posterior)
    return found | ({"stated.png": stated(rows)} if rows else {})


def numbers(posterior: Posterior) -> Figure:
    """90 % intervals of all numbers in quantiles of what was known before."""
    figure = new_figure(7.0, 0.28 * len(posterior.names) + 1.0)
    axes = figure.add_subplot()
    low, high = stats.norm.cdf(posterior.bounds())
    known, place = posterior.identified(), np.arange(len(posterior.names))[::-1]
    for chosen, colour, name in ((known, "C0", "identified"), (~known, "C3", "open")):
        if chosen.any():
            axes.hlines(place[chosen], low[chosen], high[chosen], colour, lw=5, label=name)
    axes.plot(stats.norm.cdf(posterior.z), place, "k|")
    axes.set_yticks(place, posterior.names)
    title = "90 % intervals of the machine's numbers"
    axes.set(xlim=(0.0, 1.0), xlabel="quantile of what the data sheet allows", title=title)
    legend(axes)
    return figure


def recordings(posterior: Posterior) -> Figure:
    """A few seconds of each recording held back, else of each fitted, leg 1."""
    held = bool(posterior.campaign.of(held_back=True))
    model = Model(posterior.campaign, held_back=held)
    machine, pieces = model.machine(posterior.z), model.pieces[:4]
    channel = next((name for name in pieces[0].measured if "pressure" in name), "leg_position")
    scale, unit = (1e-5, "bar") if channel != "leg_position" else (1e3, "mm")
    label = f"{channel.replace('_', ' ')} 1 [{unit}]"
    figure, rows = stack(7.0, 2.0 * len(pieces) + 1.0, *[label] * len(pieces))
    for axes, one in zip(rows, pieces, strict=True):
        found, since = one.simulated(machine, model.electronics), one.since - one.since[0]
        shown = since <= _SHOWN
        axes.plot(since[shown], scale * one.measured[channel][shown, 0], label="measured")
        axes.plot(since[shown], scale * found[channel][shown, 0], "--", label="fitted machine")
        axes.set_title(f"{channel.replace('_', ' ')} of leg 1, {one.name.replace('_', ' ')}")
    legend(rows[0])
    return figure


def stated(rows: Sequence[Stated]) -> Figure:
    """What is stated: how far the fitted machine is off, with the spread of what is open."""
    figure = new_figure(7.5, 1.3 + 0.21 * len(rows), gridded=False)
    axes = figure.add_subplot()
    axes.axvspan(-FAR, FAR, color="0.92")
    axes.axvline(0.0, color=GREY, linewidth=0.8)
    known = [(place, one) for place, one in enumerate(rows) if np.isfinite(one.off)]
    for role, colour in (("fitted", BLUE), ("held back", ORANGE)):
        mine = [(one.off, place) for place, one in known if one.role == role]
        if mine:
            axes.plot(*zip(*mine, strict=True), "o", color=colour, label=role)
    axes.set_yticks(range(len(rows)), [f"{one.evidence}, {one.what}" for one in rows], fontsize=8)
    axes.invert_yaxis()
    axes.set(xlabel="fitted machine less what is stated [deviations]")
    axes.set_title("What is stated of the machine")
    legend(axes)
    return figure
