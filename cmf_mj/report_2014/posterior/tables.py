"""Tables, sentences and figures of a study of the unknown, all computed from its files."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from cmf_mj.core.files import write_text
from cmf_mj.core.result import Result, column
from cmf_mj.machine.geometry import DOFS
from cmf_mj.report_2014.posterior import answers
from cmf_mj.report_2014.posterior.answers import (
    EVIDENCE,
    ROBUST,
    Array,
    GainStep,
    filter_name,
    interval,
    percent,
    probability_text,
)
from cmf_mj.report_2014.posterior.evidence import FLOWN
from cmf_mj.report_2014.posterior.run import GROUPS, MAPS, Results
from cmf_mj.show.look import COLOURS, DARK, GREY, PALE, legend, new_figure, save_files
from cmf_mj.studies.fit.sampling import effective_size

DERIVED = "acceleration_d2"
"""Law that reaches on single legs what the report hoped for in rotation."""

PRINTED = "acceleration_eq_3_6"
"""Acceleration feedback with gain, sign and filter as printed."""

OPPOSED = "acceleration_opposing"
"""As `PRINTED` with the opposite sign."""

FAST = "acceleration"
"""Acceleration feedback as printed behind the filter that the text describes."""


def posterior_tables(results: Results) -> dict[str, Result[Any]]:
    """All tables by the name of their file."""
    return {
        "stability": answers.stability(results),
        "changes": answers.changes(results),
        "spans": answers.spans(results),
        "gains": answers.gain_steps(results),
        "unknowns": answers.unknowns(results),
        "evidence": answers.checks(results),
    }


def best_gain(results: Results) -> GainStep:
    """The gain and filter of most damping, by the median, among those that fail least."""
    steps = answers.gain_steps(results)
    sure = [one for one in steps if one.stable >= 1.0 - ROBUST]
    return max(sure or steps, key=lambda one: one.damping[1])


def _list(names: Iterable[str]) -> str:
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last


def robust_text(results: Results) -> str:
    """What holds whatever is assumed, as a Markdown list."""
    rows, lines = answers.stability(results), []
    names = {law.name for law in results.study.laws}
    if DERIVED in names:
        mine = [row for row in rows if row.law == DERIVED]
        parts = _list(f"{probability_text(one.sampled)} with the {one.cab.upper()}" for one in mine)
        lines.append(
            f"`{DERIVED}`, which has Table D-2's bandwidths on single legs, is unstable on the "
            f"hexapod with a probability of {parts}; before any evidence of "
            f"{_list(percent(one.prior) for one in mine)}. Simulated, it rings on "
            f"{_list(f'{one.simulated} of {one.machines}' for one in mine)} machines."
        )
    for one in answers.changes(results):
        if one.cab == results.study.cabs[0].name and one.law in (PRINTED, FAST, OPPOSED):
            lines.append(
                f"`{one.law}` changes the pair's damping ratio by "
                f"{interval(one.posterior, '+.3f')} with the {one.cab.upper()}, before any "
                f"evidence by {interval(one.prior, '+.3f')}; under all evidence "
                f"{probability_text(one.same_sign)} have the median's sign."
            )
    sure = [one for one in rows if one.robust]
    for law in dict.fromkeys(one.law for one in sure):
        cabs = [one for one in sure if one.law == law]
        if law in (DERIVED, FLOWN) or len({one.posterior > 0.5 for one in cabs}) > 1:
            continue
        what = "unstable" if cabs[0].posterior > 0.5 else "stable"
        least = min(max(one.sampled[0], 1.0 - one.sampled[2]) for one in cabs)
        lines.append(
            f"`{law}` is {what} with {_list(one.cab.upper() for one in cabs)} whatever is left "
            f"out: on at least {percent(least)} of the machines under all evidence, at 95 % "
            "confidence."
        )
    return "".join(f"- {line}\n" for line in lines)


def fragile_text(results: Results) -> str:
    """What depends on numbers nobody published, or on one part of the evidence, as a list."""
    lines, moved = [], answers.moved(results)
    stability = answers.stability(results)
    for law in dict.fromkeys(one.law for one in stability if not one.robust):
        if law in (DERIVED, FLOWN):
            continue
        mine = [one for one in stability if one.law == law]
        said = _list(f"{probability_text(one.sampled)} with the {one.cab.upper()}" for one in mine)
        away = {g: sum(abs(one.without[g] - one.posterior) for one in mine) for g in GROUPS}
        most = max(GROUPS, key=lambda group: away[group])
        left = _list(f"{percent(one.without[most])}" for one in mine)
        swings = sorted((one for one in moved if one.law == law), key=lambda one: -one.swing)
        turned = [f"`{one.unknown}`" for one in swings if one.turns]
        more = [f"{len(turned) - 4} more"] if len(turned) > 4 else []
        flips = f" One of these turns its verdict: {_list(turned[:4] + more)}." if turned else ""
        lines.append(
            f"`{law}` is unstable with a probability of {said}, without the evidence "
            f"*{EVIDENCE[most]}* of {left}. Its least damping ratio depends "
            f"most on {_list(f'`{one.unknown}`' for one in swings[:3])}.{flips}"
        )
    return "".join(f"- {line}\n" for line in lines)


def advice_text(results: Results) -> str:
    """Which gain and filter machines drawn from the posterior bear best."""
    best, steps = best_gain(results), answers.gain_steps(results)
    (none,) = {one.stable for one in steps if one.gain == 0.0 and one.corner == best.corner}
    behind = "unfiltered" if best.corner == 0.0 else f"behind {filter_name(best.corner)}"
    return (
        f"Of the gains and filters tried, {best.gain:g} %/(in/s²) {behind} leaves the most "
        f"damping: a least damping ratio of {interval(best.damping, '.3f')} with any cab, stable "
        f"with all of them on {percent(best.stable)} of {results.study.settings.kept} machines "
        f"drawn from the posterior; without acceleration feedback on {percent(none)}.\n"
    )


def held_out_text(results: Results) -> str:
    """The prediction of the result that was never used."""
    check = answers.checks(results)[-1]
    verdict = "lies within" if check.inside else "does not lie within"
    return (
        f"Held out: the hardware's damping ratio under velocity feedback with the integral, "
        f"printed {check.observed:g}, {verdict} the 90 % interval that the posterior predicts, "
        f"{interval(check.posterior)} with the scatter of printed damping ratios; before any "
        f"evidence {interval(check.prior)}.\n"
    )


def sample_text(results: Results) -> str:
    """How many machines stand behind the figures."""
    simulated, size = answers.stability(results), effective_size(answers.weights(results))
    same, run = (sum(getattr(one, name) for one in simulated) for name in ("agreeing", "machines"))
    return (
        f"{results.machines.num_rows} machines drawn, effective sample size "
        f"{size:.0f}; {results.study.settings.kept} drawn from the "
        f"posterior and measured. Linear and simulated verdicts agree in {same} of {run} runs, "
        f"{percent(same / max(run, 1), 1)}.\n"
    )


TEXTS: Mapping[str, Any] = {
    "robust": robust_text,
    "fragile": fragile_text,
    "advice": advice_text,
    "held_out": held_out_text,
    "sample": sample_text,
}
"""Sentences of docs/explanation/acceleration_in_rotation.md by the name of their file."""


ROTATIONS = DOFS[3:]
_MARGIN = 12
"""Points of a map that a word beside a limit takes."""
_TITLES = {"cab_height": "centre of mass, up [m]"}


def _title(results: Results, name: str) -> str:
    unit = results.study.settings.unknowns[name].unit
    text = name.replace("_", " ")
    return _TITLES.get(name, f"{text} [{unit}]" if unit != "1" else f"{text}, factor")


def _log_ticks(axis: Axis, low: float, high: float) -> None:
    """Three ticks on a logarithmic axis, as plain numbers."""
    values = np.geomspace(low, high, 3)
    axis.set_minor_locator(NullLocator())
    axis.set_ticks(values, [f"{v:,.0f}" if v > 1000.0 else f"{v:.3g}" for v in values])


def unknown_figure(results: Results) -> Figure:
    """Prior and posterior of every unknown."""
    unknowns = results.study.settings.unknowns
    columns = 4
    rows = -(-len(unknowns) // columns)
    figure = new_figure(2.8 * columns, 1.9 * rows)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    weights = answers.weights(results)
    for axis, (name, one) in zip(axes, unknowns.items(), strict=False):
        bins = one.at(np.linspace(0.0, 1.0, 16))
        values = column(results.machines, name)
        prior = answers.weights(results, ())
        axis.hist(values, bins, weights=prior, color=GREY, label="prior")
        axis.hist(
            values, bins, weights=weights, histtype="step", color=COLOURS[0], label="all evidence"
        )
        axis.set(xlabel=_title(results, name), yticks=[])
        if one.distribution == "loguniform":
            axis.set_xscale("log")
            _log_ticks(axis.xaxis, *one.at([0.0, 1.0]))
    legend(figure)
    for axis in axes[len(unknowns) :]:
        axis.set_visible(False)
    figure.suptitle(
        "Shares of machines by each unknown, before and after the evidence", fontsize=10
    )
    return figure


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
        axis.axvline(mine[names[0]].median, color=GREY, linewidth=0.9, linestyle=":")
        axis.set_title(law.replace("_", "\n", 1), fontsize=8)
    axes[0].set_yticks(at, [_title(results, name) for name in names], fontsize=8)
    legend(figure)
    cab = results.study.cabs[0].name.upper()
    axes[len(laws) // 2].set_xlabel(f"least damping ratio, cab {cab}")
    figure.suptitle("Least damping ratio with one unknown at either end of its range", fontsize=10)
    return figure


def limits_figure(results: Results) -> Figure:
    """Limits of stability of all laws in each rotation over two unknowns."""
    figure = new_figure(10.5, 9.0)
    axes = figure.subplots(len(ROTATIONS), len(MAPS), squeeze=False)
    laws = [law.name for law in results.study.laws]
    for dof, line in zip(ROTATIONS, axes, strict=True):
        for (x, y), axis in zip(MAPS, line, strict=True):
            for law, colour in zip(laws, COLOURS, strict=False):
                across, up, ratio = answers.stability_map(results, x, y, law, dof)
                if ratio.min() < 0.0 < ratio.max():
                    axis.contour(across, up, ratio.T, [0.0], colors=[colour], linewidths=1.6)
                    _name_side(axis, across, up, ratio, colour, laws.index(law) / len(laws))
            ends = {"xlim": (across[0], across[-1]), "ylim": (up[0], up[-1])}
            axis.set(xlabel=_title(results, x), ylabel=_title(results, y), title=dof, **ends)
            if results.study.settings.unknowns[y].distribution == "loguniform":
                axis.set_yscale("log")
                _log_ticks(axis.yaxis, up[0], up[-1])
    for law, colour in zip(laws, COLOURS, strict=False):
        axes[0, 0].plot([], [], color=colour, label=law)
    legend(figure)
    figure.suptitle("Where the damping ratio of each law in rotation is zero", fontsize=10)
    return figure


def _name_side(
    axis: Axes, across: Array, up: Array, ratio: Array, colour: str, share: float
) -> None:
    """Write "stable" on its side of a limit, at a share of the columns that it crosses."""
    stable = ratio > 0.0
    crossed = np.flatnonzero((stable != stable[:, :1]).any(axis=1)[:-_MARGIN])
    for at in crossed[[int(share * crossed.size)]] if crossed.size else ():
        for row in np.flatnonzero(stable[at, 1:] != stable[at, :-1]):
            high = bool(stable[at, row + 1])
            if _MARGIN < row < up.size - _MARGIN:
                style: dict[str, Any] = {"va": "bottom" if high else "top", "color": colour}
                axis.text(across[at], up[row], "stable", fontsize=7, **style)


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
            for place, law, colour in zip(at, laws, COLOURS * 2, strict=False):
                one = every[law, dof]
                low, middle, high = getattr(one, field)
                axis.plot([low, high], [place, place], color=colour, linewidth=3, alpha=0.5)
                axis.plot([middle], [place], "o", color=colour, markersize=5)
            axis.set_xlabel(title if dof == ROTATIONS[-1] else "")
        line[0].set_ylabel(dof)
        shares = [f"{law}, {100.0 * every[law, dof].stable:.0f} %" for law in laws]
        line[0].set_yticks(at, shares, fontsize=7)
    figure.suptitle(
        f"Bandwidth, peak and damping in rotation: median and 90 % of machines, cab {cab.upper()}; "
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
        left.plot(gains, [100.0 * one.stable for one in mine], "o-", color=colour, label=name)
        low, middle, high = np.array([one.damping for one in mine]).T
        right.plot(gains, middle, "o-", color=colour, label=name)
        right.fill_between(gains, low, high, color=colour, alpha=0.2)
    right.axhline(0.0, color=DARK, linewidth=0.9)
    left.set(xlabel="gain of acceleration [%/(in/s²)]", ylabel="stable with every cab [%]")
    right.set(xlabel="gain of acceleration [%/(in/s²)]", ylabel="least damping ratio of any cab")
    for axis in (left, right):
        axis.set_xticks(gains, [f"{gain:g}" for gain in gains], rotation=90)
    legend(figure)
    figure.suptitle("Stability and damping over the gain of acceleration feedback", fontsize=10)
    return figure


def save_posterior(results: Results, folder: Path) -> list[Path]:
    """Write tables, sentences and figures."""
    files: dict[str, Any] = {}
    for name, result in posterior_tables(results).items():
        files |= {f"{name}.{kind}": result.table.save for kind in ("md", "csv")}
    for name, text in TEXTS.items():
        content = text(results)
        files[f"{name}.md"] = lambda path, content=content: write_text(path, content)
    files |= {
        "unknowns.png": unknown_figure(results),
        "tornado.png": tornado_figure(results),
        "maps.png": limits_figure(results),
        "bandwidths.png": span_figure(results),
        "gains.png": gain_figure(results),
    }
    return save_files(files, folder, 90)


def summary(results: Results) -> tuple[Any, ...]:
    """What the command prints: the answer first."""
    return (
        *(TEXTS[name](results) for name in ("robust", "fragile", "advice", "held_out", "sample")),
        answers.stability(results),
    )
