"""Tables, figures and files of measured responses, and of test guides."""

from collections.abc import Sequence
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from cmf_mj.analysis.frequency_response import FrequencyResponse, bandwidths
from cmf_mj.analysis.measurable import CLEAR
from cmf_mj.analysis.measures import joined
from cmf_mj.core.files import write_text
from cmf_mj.core.result import Field, Result, Table, fields_of, lines
from cmf_mj.machine.geometry import DOFS, by_kind
from cmf_mj.machine.kinematics import legs_to_pose
from cmf_mj.show import look
from cmf_mj.studies.diagnosis import Cause
from cmf_mj.studies.guide_check import REPEATABLE, Compared, Master, smallest
from cmf_mj.studies.measurement import RecordingMeasures, accelerations, driven

_FIT = "second-order fit with delay"


def _fields(*rows: tuple[str, str, str, str]) -> tuple[Field, ...]:
    """Of path, title, format and meaning."""
    return tuple(
        Field("", title, form, "%" if form[-1] == "%" else "", path, about=about)
        for path, title, form, about in rows
    )


RESPONSE = _fields(
    ("measures.phase_bandwidth_hz", "-90 deg bandwidth", ".3f Hz", "first fall through it"),
    ("measures.later_phase_hz", "-90 deg, later", ".3f Hz", "last fall, after coming back"),
    ("measures.graze_from_hz", "-90 deg, grazed from", ".2f Hz", "lingers within 10 deg of it"),
    ("measures.graze_to_hz", "  to", ".2f Hz", ""),
    ("measures.gain_bandwidth_hz", "-3 dB bandwidth", ".3f Hz", "from 0 dB"),
    ("measures.peak_gain_db", "peak", ".2f dB", "largest gain"),
    ("coherence", "coherence", ".4f", "least of all lines"),
    ("second_order.natural_frequency_hz", "natural frequency", ".3f Hz", _FIT),
    ("second_order.damping_ratio", "damping ratio", ".3f", _FIT),
    ("second_order.residual", "fit residual", ".2f %", "rms misfit over rms response"),
)


def recordings_table(measures: RecordingMeasures) -> Table:
    """Bandwidths, peak and second-order fit of recordings."""
    response = measures.response
    found = {"measures": joined(bandwidths(response)), "second_order": measures.second_order}
    why = f"not excited, or of a coherence below {CLEAR:g}"
    rows = lines(found | {"coherence": response.coherence.min()}, RESPONSE)
    title = f"{measures.dof}: {', '.join(path.name for path in measures.files)}"
    return _sheet(title, [*rows, ("lines left out", str(measures.left_out), why)])


def _sheet(title: str, rows: list[tuple[str, str, str]]) -> Table:
    return Table(title, ("measure", "value", "definition"), rows)


def response_figure(title: str, name: str, response: FrequencyResponse) -> Figure:
    """Gain and phase of a measured response with their 95 % bounds, and its coherence."""
    labels, ratios = ("gain [dB]", "phase [deg]", "coherence"), (3, 3, 1)
    figure, axes = look.stack(8.0, 8.0, *labels, x="frequency [Hz]", ratios=ratios)
    gain, phase, coherence = axes
    look.dress_bode(gain, phase, title, limits=True)
    phase.set_xlabel("")
    colour = look.plot_bode(gain, phase, response, label=name)
    coherence.plot(response.frequency, response.coherence, color=colour)
    coherence.set_ylim(0.0, 1.05)
    share = np.minimum(response.bound / np.abs(response.response), 0.99)
    look.plot_band(gain, phase, response, share, np.arcsin(share), color=colour)
    look.legend(figure)
    return figure


def _response_files(response: FrequencyResponse, figure: Figure) -> dict[str, Any]:
    """`response.csv`, with the radius of the 95 % circle, and `response.png`."""
    columns = {
        "frequency_hz": response.frequency,
        "gain_db": response.gain_db,
        "phase_deg": response.phase_deg,
        "coherence": response.coherence,
        "radius_95": response.bound,
    }
    return {"response.csv": columns, "response.png": figure}


def save_recordings(measures: RecordingMeasures, folder: Path) -> list[Path]:
    """Write `response.csv`, `response.png` and `summary.json`."""
    figure = response_figure(
        f"Frequency response in {measures.dof}", measures.files[0].stem, measures.response
    )
    files = _response_files(measures.response, figure)
    return look.save_files(files | {"summary.json": measures.summary()}, folder)


_STYLE = """@page { margin: 15mm } body { font: 10pt sans-serif; max-width: 180mm; margin: auto }
table { border-collapse: collapse; font-size: 8pt; margin: 1em 0 } figure { margin: 0 }
td, th { border: 1px solid #bbb; padding: 2px 6px; text-align: left } img { width: 100% }
section, figure, tr { break-inside: avoid } caption { text-align: left; font-weight: bold }"""


def page(title: str, parts: Sequence[Table | str | Path]) -> str:
    """A page that prints: tables, text, and pictures beside it by their names."""
    body = []
    for part in parts:
        match part:
            case Table():
                rows = [f"<caption>{escape(part.title)}</caption>"]
                for tag, cells in [("th", part.header), *(("td", row) for row in part.cells)]:
                    row = "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells)
                    rows.append(f"<tr>{row}</tr>")
                body.append(f"<table>{''.join(rows)}</table>")
            case Path():
                body.append(f'<figure><img src="{escape(part.name)}" alt="{part.stem}"></figure>')
            case text:
                body.append(f"<p>{escape(text)}</p>")
    head = f'<meta charset="utf-8"><title>{escape(title)}</title><style>{_STYLE}</style>'
    whole = f"<!DOCTYPE html><html lang=en><head>{head}</head><body><h1>{escape(title)}</h1>"
    return f"{whole}{''.join(body)}</body></html>\n"


def overplot(master: Master, new: Master | None, name: str) -> Figure:
    """A test along the axis that moves most: motion, acceleration, and both less the master's mean.

    Of translations if any moves; the band is twice the deviation of the master's repetitions.
    """
    records = master.records[name]
    machine, time = master.bench.plant.machine, records[0].time
    demand = legs_to_pose(records[0]["leg_reference"], machine)
    reach = np.ptp(demand, axis=0)
    axis = (
        int(np.argmax(reach[:3]))
        if reach[:3].max() > 0.1 * reach[3:].max()
        else 3 + int(np.argmax(reach[3:]))
    )
    unit = by_kind(DOFS[axis], "m", "rad")
    less = "now less master" if new else "repetitions less mean"
    labels = (f"{DOFS[axis]} [{unit}]", f"{less} [{unit}]", f"acceleration [{unit}/s^2]")
    figure, axes = look.stack(8.0, 6.5, *labels)

    def histories(of: Master) -> Any:
        moved = [legs_to_pose(one["leg_position"], machine)[:, axis] for one in of.records[name]]
        felt = [accelerations(one)[:, axis] for one in of.records[name]]
        count = min(len(time), *map(len, moved))
        return tuple(np.array([one[:count] for one in many]) for many in (moved, felt))

    moved, felt = histories(master)
    count = moved.shape[1]
    at, mean = time[:count], moved.mean(axis=0)
    spread = 2.0 * np.sqrt(((moved - mean) ** 2).sum(axis=0) / max(1, len(moved) - 1))
    axes[0].plot(at, demand[:count, axis], color=look.GREY, lw=0.8, label="demand")
    axes[0].plot(at, mean, color=look.DARK, label="master")
    axes[1].fill_between(at, -spread, spread, color=look.BLUE, alpha=0.3, label="repetitions")
    axes[2].plot(at, felt.mean(axis=0), color=look.DARK)
    if new is not None:
        for one, other in zip(*histories(new), strict=True):
            n = min(count, len(one))
            axes[0].plot(at[:n], one[:n], "--", color=look.ORANGE, lw=0.9, label="now")
            axes[1].plot(at[:n], one[:n] - mean[:n], color=look.ORANGE, lw=0.7)
            axes[2].plot(at[:n], other[:n], "--", color=look.ORANGE, lw=0.9)
    said = master.bench.of[name].title.lower()
    axes[0].set_title(f"Motion in {DOFS[axis]}, {said} ({name.replace('_', ' ')})")
    look.legend(figure)
    return figure


def _pictures(master: Master, new: Master | None, names: Sequence[str]) -> dict[str, Figure]:
    """Over-plots of tests, and Bode plots of those with frequency responses, by file."""
    drawn = {}
    for name in names:
        drawn[f"{name}.png"] = overplot(master, new, name)
        if "response" in master.bench.of[name].measures:
            own = driven(master.records[name][0])[0]
            now = driven(new.records[name][0])[0] if new else {}
            curves = {
                f"{dof}{when}": of[dof]
                for dof in own
                for when, of in (("", own), (", now", now))
                if of
            }
            title = f"Gain and phase, first repetition: {master.bench.of[name].title.lower()}"
            drawn[f"{name}_bode.png"] = look.bode_figure(title, curves, limits=True)[0]
    return drawn


def _about(master: Master) -> list[Table | str]:
    """What a guide is, on which machine, and its recordings."""
    guide, on = master.head.guide, master.bench
    known = ", ".join(f"{key} {value}" for key, value in on.known.items())
    made = "simulated with noisy electronics" if master.head.simulated else "recorded"
    rows = []
    for name, one in on.of.items():
        limit = ", ".join(f"{k} up to {v:g}" for k, v in one.limits.items()) or (
            f"none: {one.no_limit}"
        )
        why = master.head.aborted.get(name)
        done = f"aborted: {why}" if why else str(len(master.records.get(name, ())))
        rows.append((name, one.source, one.conditions, f"{on.use[name]:.0%}", done, limit))
    rows += [(name, "", "", "", why, "") for name, why in on.impossible.items()]
    rows += [
        (name, "", "", "", f"set aside: {why}", "") for name, why in master.head.set_aside.items()
    ]
    columns = ("test", "source", "conditions", "use of limits", "repetitions", "limit")
    return [
        f"{guide.source}. {known}; {made} by version {master.head.version}.",
        Table("Tests", columns, rows),
    ]


def save_master(master: Master, again: int = 2) -> list[Path]:
    """Write `guide.html`, `measures.csv` and a picture a test; `again` repetitions are checked."""
    guide, rows = master.head.guide, []
    share = guide.false_alarm / (2.0 * len(master.records))
    for name in master.records:
        found = master.measured(name, master.mean(name))
        n = len(found)
        for measure in found[0]:
            values = np.array([one[measure] for one in found])
            spread = float(values.std(ddof=1)) if n > 1 else float("nan")
            seen = float("nan")
            if n > 1 and measure != REPEATABLE:
                seen = spread * smallest(n, again, share / max(1, len(found[0]) - 1))
            rows.append((name, measure, float(values.mean()), spread, seen))
    head = f"change found with 90 % by {again} repetitions"
    columns = ("test", "measure", ("mean", ".4g"), ("deviation", ".2g"), (head, ".2g"))
    table = Table("Measures of the repetitions", columns, rows)
    files = Table("Recordings", ("file", "digest"), list(master.head.digests.items()))
    return _saved(
        guide.title,
        master.folder,
        [*_about(master), table],
        _pictures(master, None, list(master.records)),
        {"measures.csv": table},
        files,
    )


def _saved(
    title: str, folder: Path, parts: Any, pictures: Any, tables: Any, *last: Any
) -> list[Path]:
    whole = [*parts, *map(Path, pictures), *last]
    printed = partial(write_text, text=page(title, whole))
    return look.save_files({**pictures, **tables, "guide.html": printed}, folder)


def compared_table(rows: Sequence[Compared]) -> Result[Compared]:
    """Every measure of every test beside the master's."""
    return Result(rows, fields_of(Compared), "Measures against the master's")


def verdict_table(rows: Sequence[Compared]) -> Table:
    """Each test with the worst that its measures say."""
    names = list(dict.fromkeys(row.test for row in rows))
    found = []
    for name in names:
        mine = [row for row in rows if row.test == name]
        odd = [row for row in mine if row.verdict != "as before"]
        said = "; ".join(dict.fromkeys(row.verdict for row in odd)) or "as before"
        found.append((name, said, ", ".join(row.measure for row in odd[:4])))
    return Table("Verdicts", ("test", "verdict", "because of"), found)


def causes_table(causes: Sequence[Cause]) -> Result[Cause]:
    """What most probably changed."""
    return Result(causes, fields_of(Cause), "What most probably changed")


def save_check(
    master: Master, new: Master, rows: Sequence[Compared], causes: Sequence[Cause], folder: Path
) -> list[Path]:
    """Write `guide.html`, `check.csv`, `causes.csv` and an over-plot a test."""
    both = [name for name in master.records if name in new.records]
    pictures = _pictures(master, new, both)
    compared = compared_table(rows)
    tables: dict[str, Any] = {"check.csv": compared}
    parts: list[Any] = [f"{new.folder} against {master.folder}", verdict_table(rows)]
    if causes:
        parts.append(causes_table(causes).table)
        tables["causes.csv"] = causes_table(causes)
    title = f"{master.head.guide.title}: check"
    return _saved(title, folder, [*parts, compared.table], pictures, tables)
