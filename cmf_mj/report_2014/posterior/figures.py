"""Figures of a study of the unknown, all computed from its files."""

import numpy as np
from matplotlib.figure import Figure

from cmf_mj.machine.geometry import DOFS
from cmf_mj.report_2014.posterior import answers
from cmf_mj.report_2014.posterior.run import Results
from cmf_mj.show.look import COLOURS, DARK, GREY, PALE, legend, new_figure

ROTATIONS = DOFS[3:]
_TITLES = {"cab_height": "centre of mass, up [m]"}


def _title(results: Results, name: str) -> str:
    unit = results.study.settings.unknowns[name].unit
    text = name.replace("_", " ")
    return _TITLES.get(name, f"{text} [{unit}]" if unit != "1" else f"{text}, factor")


def tornado_figure(results: Results) -> Figure:
    """Least damping ratio of each law with one unknown at the ends of its range; dotted, none."""
    laws = [law.name for law in results.study.laws]
    moved = answers.moved(results)
    swing: dict[str, float] = {}
    for one in moved:
        swing[one.unknown] = max(swing.get(one.unknown, 0.0), one.swing)
    names = sorted(swing, key=lambda name: swing[name])
    figure = new_figure(2.1 * len(laws) + 1.4, 0.26 * len(names) + 1.2)
    axes = figure.subplots(1, len(laws), sharey=True, squeeze=False)[0]
    at = np.arange(len(names))
    for axis, law in zip(axes, laws, strict=True):
        mine = {one.unknown: one for one in moved if one.law == law}
        low, high = (np.array([getattr(mine[n], end) for n in names]) for end in ("low", "high"))
        ends = np.array([low, high, np.full(len(names), mine[names[0]].median)])
        left, right = ends.min(axis=0), ends.max(axis=0)
        axis.barh(at, right - left, left=left, height=0.5, color=PALE, edgecolor=GREY)
        axis.plot(low, at, "o", color=COLOURS[0], markersize=4, label="low")
        axis.plot(high, at, "s", color=COLOURS[1], markersize=4, label="high")
        axis.axvline(0.0, color=DARK, linewidth=0.9)
        axis.margins(x=0.12)
        axis.axvline(mine[names[0]].median, color=GREY, linewidth=0.9, linestyle=":")
        axis.set_title(law.replace("_", "\n", 1), fontsize=8)
    axes[0].set_yticks(at, [_title(results, name) for name in names], fontsize=8)
    legend(figure)
    cab = results.study.cabs[0].name.upper()
    axes[len(laws) // 2].set_xlabel(f"least damping ratio, cab {cab}; unstable left of 0")
    figure.suptitle(
        "Least damping ratio with one unknown at 5 and 95 % of its range, model without friction",
        fontsize=10,
    )
    return figure


def span_figure(results: Results) -> Figure:
    """Measures in rotation on machines drawn from the posterior: median and 90 % interval."""
    fields = {
        "phase_bandwidth_hz": "-90 deg [Hz]",
        "gain_bandwidth_hz": "-3 dB [Hz]",
        "peak_gain_db": "peak [dB]",
        "damping_ratio": "damping ratio of a step",
    }
    laws = [law.name for law in results.study.laws]
    cab = results.study.cabs[0].name
    every = {(one.law, one.dof): one for one in answers.spans(results) if one.cab == cab}
    figure = new_figure(11.0, 0.34 * len(laws) * len(ROTATIONS) + 1.4)
    axes = figure.subplots(len(ROTATIONS), len(fields), sharex="col", sharey=True, squeeze=False)
    at = np.arange(len(laws))[::-1]
    for dof, line in zip(ROTATIONS, axes, strict=True):
        for (field, title), axis in zip(fields.items(), line, strict=True):
            for place, law, colour in zip(at, laws, (*COLOURS, GREY, DARK), strict=False):
                one = every[law, dof]
                low, middle, high = getattr(one, field)
                axis.plot([low, high], [place, place], color=colour, linewidth=3, alpha=0.5)
                axis.plot([middle], [place], "o", color=colour, markersize=5)
            axis.set_xlabel(title if dof == ROTATIONS[-1] else "")
        line[0].set_ylabel(dof)
        shares = [f"{law}, {answers.percent(every[law, dof].stable[1])}" for law in laws]
        line[0].set_yticks(at, shares, fontsize=7)
    figure.suptitle(
        f"Small motion in rotation: median and 90 % of machines, cab {cab.upper()}, no friction; "
        "after each law the share that it leaves stable",
        fontsize=9,
    )
    return figure


def gain_figure(results: Results) -> Figure:
    """Share of stable machines and least damping ratio by gain of acceleration, for each filter."""
    figure = new_figure(9.0, 3.6)
    left, right = figure.subplots(1, 2)
    steps = answers.gain_steps(results)
    for corner, colour in zip(dict.fromkeys(one.corner for one in steps), COLOURS, strict=False):
        mine = sorted((one for one in steps if one.corner == corner), key=lambda one: one.gain)
        gains = [one.gain for one in mine]
        name = "no filter" if corner == 0.0 else f"filter {corner:.3g} Hz"
        low, middle, high = 100.0 * np.array([one.stable for one in mine]).T
        left.plot(gains, middle, "o-", color=colour, label=name)
        left.fill_between(gains, low, high, color=colour, alpha=0.2)
        low, middle, high = np.array([one.damping for one in mine]).T
        right.plot(gains, middle, "o-", color=colour, label=name)
        right.fill_between(gains, low, high, color=colour, alpha=0.2)
    right.axhline(0.0, color=DARK, linewidth=0.9)
    for place, side in ((0.98, "stable"), (0.02, "unstable")):
        edge = "top" if side == "stable" else "bottom"
        right.text(0.02, place, side, transform=right.transAxes, va=edge)
    left.set(xlabel="gain of acceleration [%/(in/s²)]", ylabel="stable with every cab [%]")
    right.set(xlabel="gain of acceleration [%/(in/s²)]", ylabel="least damping ratio of any cab")
    for axis in (left, right):
        axis.set_xticks(gains, [f"{gain:g}" for gain in gains], rotation=90)
    legend(figure)
    figure.suptitle(
        "Stability and damping over the gain of acceleration feedback, model without friction",
        fontsize=10,
    )
    return figure


def posterior_figures(results: Results) -> dict[str, Figure]:
    """All figures by the name of their file."""
    return {
        "tornado.png": tornado_figure(results),
        "bandwidths.png": span_figure(results),
        "gains.png": gain_figure(results),
    }
