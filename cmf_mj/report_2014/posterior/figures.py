"""Figures of a study of the unknown, all computed from its files."""

import numpy as np
from matplotlib.figure import Figure

from cmf_mj.report_2014.posterior import answers
from cmf_mj.report_2014.posterior.run import Results
from cmf_mj.show.look import COLOURS, DARK, GREY, PALE, legend, new_figure

_ROTATIONS = ("roll", "pitch", "yaw")
_UNKNOWN_TITLES = {"cab_height": "centre of mass, up [m]"}
_MEASURE_TITLES = {
    "phase_bandwidth_hz": "-90 deg [Hz]",
    "gain_bandwidth_hz": "-3 dB [Hz]",
    "peak_gain_db": "peak [dB]",
    "damping_ratio": "damping ratio of a step",
}


def _unknown_title(results: Results, name: str) -> str:
    unit = results.study.settings.unknowns[name].unit
    text = name.replace("_", " ")
    return _UNKNOWN_TITLES.get(name, f"{text} [{unit}]" if unit != "1" else f"{text}, factor")


def tornado_figure(results: Results) -> Figure:
    """Least damping ratio of each law with one unknown at the ends of its range; dotted, none."""
    laws = [law.name for law in results.study.laws]
    rows = {(row.unknown, row.law): row for row in answers.sensitivities(results)}
    unknowns = results.study.settings.unknowns
    largest_swing = {name: max(rows[name, law].swing for law in laws) for name in unknowns}
    names = sorted(largest_swing, key=lambda name: largest_swing[name])
    figure = new_figure(2.1 * len(laws) + 1.4, 0.26 * len(names) + 1.2)
    (panels,) = figure.subplots(1, len(laws), sharey=True, squeeze=False)
    bars = np.arange(len(names))
    for panel, law in zip(panels, laws, strict=True):
        rows_of_law = [rows[name, law] for name in names]
        damping = np.array([(row.low, row.high, row.median) for row in rows_of_law]).T
        low, high, median = damping
        least, largest = damping.min(axis=0), damping.max(axis=0)
        panel.barh(bars, largest - least, left=least, height=0.5, color=PALE, edgecolor=GREY)
        panel.plot(low, bars, "o", color=COLOURS[0], markersize=4, label="low")
        panel.plot(high, bars, "s", color=COLOURS[1], markersize=4, label="high")
        panel.axvline(0.0, color=DARK, linewidth=0.9)
        panel.margins(x=0.12)
        panel.axvline(median[0], color=GREY, linewidth=0.9, linestyle=":")
        panel.set_title(law.replace("_", "\n", 1), fontsize=8)
    panels[0].set_yticks(bars, [_unknown_title(results, name) for name in names], fontsize=8)
    legend(figure)
    cab = results.study.cabs[0].name.upper()
    panels[len(laws) // 2].set_xlabel(f"least damping ratio, cab {cab}; unstable left of 0")
    figure.suptitle(
        "Least damping ratio with one unknown at 5 and 95 % of its range, model without friction",
        fontsize=10,
    )
    return figure


def bandwidth_figure(results: Results) -> Figure:
    """Measures in rotation on machines drawn from the posterior: median and 90 % interval."""
    laws = [law.name for law in results.study.laws]
    cab = results.study.cabs[0].name
    rows = {(row.law, row.dof): row for row in answers.law_measures(results) if row.cab == cab}
    figure = new_figure(11.0, 0.34 * len(laws) * len(_ROTATIONS) + 1.4)
    size = len(_ROTATIONS), len(_MEASURE_TITLES)
    panels = figure.subplots(*size, sharex="col", sharey=True, squeeze=False)
    bars = np.arange(len(laws))[::-1]
    for dof, panels_of_dof in zip(_ROTATIONS, panels, strict=True):
        for (field, title), panel in zip(_MEASURE_TITLES.items(), panels_of_dof, strict=True):
            for bar, law, colour in zip(bars, laws, (*COLOURS, GREY, DARK), strict=False):
                low, middle, high = getattr(rows[law, dof], field)
                panel.plot([low, high], [bar, bar], color=colour, linewidth=3, alpha=0.5)
                panel.plot([middle], [bar], "o", color=colour, markersize=5)
            panel.set_xlabel(title if dof == _ROTATIONS[-1] else "")
        shares = [f"{law}, {answers.percent_text(rows[law, dof].stable[1])}" for law in laws]
        panels_of_dof[0].set_ylabel(dof)
        panels_of_dof[0].set_yticks(bars, shares, fontsize=7)
    figure.suptitle(
        f"Small motion in rotation: median and 90 % of machines, cab {cab.upper()}, no friction; "
        "after each law the share that it leaves stable",
        fontsize=9,
    )
    return figure


def gain_figure(results: Results) -> Figure:
    """Share of stable machines and least damping ratio by gain of acceleration, for each filter."""
    figure = new_figure(9.0, 3.6)
    stable_panel, damping_panel = figure.subplots(1, 2)
    steps = answers.gain_steps(results)
    for corner, colour in zip(dict.fromkeys(step.corner for step in steps), COLOURS, strict=False):
        curve = sorted((step for step in steps if step.corner == corner), key=lambda s: s.gain)
        gains = [step.gain for step in curve]
        name = "no filter" if corner == 0.0 else f"filter {corner:.3g} Hz"
        stable_percent = 100.0 * np.array([step.stable for step in curve])
        damping = np.array([step.damping for step in curve])
        for panel, spans in ((stable_panel, stable_percent), (damping_panel, damping)):
            low, middle, high = spans.T
            panel.plot(gains, middle, "o-", color=colour, label=name)
            panel.fill_between(gains, low, high, color=colour, alpha=0.2)
    damping_panel.axhline(0.0, color=DARK, linewidth=0.9)
    damping_panel.text(0.02, 0.98, "stable", transform=damping_panel.transAxes, va="top")
    damping_panel.text(0.02, 0.02, "unstable", transform=damping_panel.transAxes, va="bottom")
    stable_panel.set_ylabel("stable with every cab [%]")
    damping_panel.set_ylabel("least damping ratio of any cab")
    for panel in (stable_panel, damping_panel):
        panel.set_xlabel("gain of acceleration [%/(in/s²)]")
        panel.set_xticks(gains, [f"{gain:g}" for gain in gains], rotation=90)
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
        "bandwidths.png": bandwidth_figure(results),
        "gains.png": gain_figure(results),
    }
