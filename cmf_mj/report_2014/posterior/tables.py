"""Tables and sentences of a study of the unknown, every number of them computed from its files."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from cmf_mj.core.files import write_text
from cmf_mj.core.result import Result
from cmf_mj.report_2014.posterior import answers
from cmf_mj.report_2014.posterior import figures as figures
from cmf_mj.report_2014.posterior.answers import (
    EVIDENCE,
    ROBUST,
    GainStep,
    filter_name,
    interval,
    percent,
)
from cmf_mj.report_2014.posterior.evidence import FLOWN
from cmf_mj.report_2014.posterior.run import GROUPS, Results
from cmf_mj.show.look import save_files
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
        parts = _list(f"{percent(one.posterior)} with the {one.cab.upper()}" for one in mine)
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
                f"{percent(one.same_sign)} have the median's sign."
            )
    sure = [one for one in rows if one.robust]
    for law in dict.fromkeys(one.law for one in sure):
        cabs = [one for one in sure if one.law == law]
        if law in (DERIVED, FLOWN) or len({one.posterior > 0.5 for one in cabs}) > 1:
            continue
        what = "unstable" if cabs[0].posterior > 0.5 else "stable"
        share = min(max(one.posterior, 1.0 - one.posterior) for one in cabs)
        lines.append(
            f"`{law}` is {what} with {_list(one.cab.upper() for one in cabs)} whatever is left "
            f"out: on at least {percent(share)} of the machines under all evidence."
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
        shares = _list(f"{percent(one.posterior)} ({one.cab.upper()})" for one in mine)
        away = {g: sum(abs(one.without[g] - one.posterior) for one in mine) for g in GROUPS}
        most = max(GROUPS, key=lambda group: away[group])
        left = _list(f"{percent(one.without[most])}" for one in mine)
        swings = sorted((one for one in moved if one.law == law), key=lambda one: -one.swing)
        turned = [f"`{one.unknown}`" for one in swings if one.turns]
        more = [f"{len(turned) - 4} more"] if len(turned) > 4 else []
        flips = f" One of these turns its verdict: {_list(turned[:4] + more)}." if turned else ""
        lines.append(
            f"`{law}` is unstable with a probability of {shares}, without the evidence "
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


def save_posterior(results: Results, folder: Path) -> list[Path]:
    """Write tables, sentences and figures."""
    files: dict[str, Any] = {}
    for name, result in posterior_tables(results).items():
        files |= {f"{name}.{kind}": result.table.save for kind in ("md", "csv")}
    for name, text in TEXTS.items():
        content = text(results)
        files[f"{name}.md"] = lambda path, content=content: write_text(path, content)
    files |= {
        "unknowns.png": figures.unknown_figure(results),
        "tornado.png": figures.tornado_figure(results),
        "maps.png": figures.limits_figure(results),
        "bandwidths.png": figures.span_figure(results),
        "gains.png": figures.gain_figure(results),
    }
    return save_files(files, folder, 90)


def summary(results: Results) -> tuple[Any, ...]:
    """What the command prints: the answer first."""
    return (
        *(TEXTS[name](results) for name in ("robust", "fragile", "advice", "held_out", "sample")),
        answers.stability(results),
    )
