"""Tables, figures and files of measured responses, and of test guides."""

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from markdown_it import MarkdownIt
from matplotlib.figure import Figure

from cmf_mj.analysis.frequency_response import FrequencyResponse, bandwidths
from cmf_mj.analysis.measurable import CLEAR
from cmf_mj.analysis.measures import measures_from
from cmf_mj.core.files import write_text
from cmf_mj.core.result import Field, Result, Table, fields_of, lines
from cmf_mj.machine.geometry import DOFS, by_kind
from cmf_mj.machine.kinematics import legs_to_pose
from cmf_mj.show import look
from cmf_mj.studies.diagnosis import Cause
from cmf_mj.studies.guide_check import Compared, Master
from cmf_mj.studies.measurement import RecordingMeasures, accelerations, driven_responses

RESPONSE = tuple(
    Field("", title, form, "", path, about=about)
    for path, title, form, about in (
        ("measures.phase_bandwidth_hz", "-90 deg bandwidth", ".3f Hz", "first fall through it"),
        ("measures.later_phase_hz", "-90 deg, later", ".3f Hz", "last fall, after coming back"),
        ("measures.graze_from_hz", "-90 deg, grazed from", ".2f Hz", "lingers within 10 deg of it"),
        ("measures.graze_to_hz", "  to", ".2f Hz", ""),
        ("measures.gain_bandwidth_hz", "-3 dB bandwidth", ".3f Hz", "from 0 dB"),
        ("measures.peak_gain_db", "peak", ".2f dB", "largest gain"),
        ("coherence", "coherence", ".4f", "least of all lines"),
    )
)


def recordings_table(measures: RecordingMeasures) -> Table:
    """Bandwidths and peak of recordings."""
    response = measures.response
    found = {"measures": measures_from(bandwidths(response))}
    why = f"not excited, or of a coherence below {CLEAR:g}"
    rows = lines(found | {"coherence": response.coherence.min()}, RESPONSE)
    title = f"{measures.dof}: {', '.join(path.name for path in measures.files)}"
    rows.append(("lines left out", str(measures.left_out), why))
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
    look.plot_bound(gain, phase, response, color=colour)
    look.legend(figure)
    return figure


def save_recordings(measures: RecordingMeasures, folder: Path) -> list[Path]:
    """Write `response.csv`, with the radius of the 95 % circle, its figure and `measures.csv`."""
    response, title = measures.response, f"Frequency response in {measures.dof}"
    columns = {
        "frequency_hz": response.frequency,
        "gain_db": response.gain_db,
        "phase_deg": response.phase_deg,
        "coherence": response.coherence,
        "radius_95": response.bound,
    }
    figure = response_figure(title, measures.files[0].stem, response)
    table = recordings_table(measures)
    files = {"response.csv": columns, "response.png": figure, "measures.csv": table}
    return look.save_files(files, folder)


def overplot(master: Master, new: Master, name: str) -> Figure:
    """A test along the axis that moves most: motion, acceleration, and both less the master's mean.

    Of translations if any moves; the band is twice the deviation of the master's repetitions.
    """
    records = master.records[name]
    machine, time = master.bench.plant.machine, records[0].time
    demand = legs_to_pose(records[0]["leg_reference"], machine)
    reach = np.ptp(demand, axis=0)
    first = 0 if reach[:3].max() > 0.1 * reach[3:].max() else 3
    axis = first + int(np.argmax(reach[first : first + 3]))
    unit, again = by_kind(DOFS[axis], "m", "rad"), new is not master
    less = "now less master" if again else "repetitions less mean"
    labels = (f"{DOFS[axis]} [{unit}]", f"{less} [{unit}]", f"acceleration [{unit}/s^2]")
    figure, axes = look.stack(8.0, 6.5, *labels)
    every = [(one, record) for one in (master, new)[: 1 + again] for record in one.records[name]]
    count = min(len(record.time) for _, record in every)
    at = time[:count]

    def histories(of: Master) -> Any:
        mine = [record for one, record in every if one is of]
        moved = [legs_to_pose(record["leg_position"], machine)[:count, axis] for record in mine]
        return np.array(moved), np.array([accelerations(record)[:count, axis] for record in mine])

    moved, felt = histories(master)
    mean = moved.mean(axis=0)
    spread = 2.0 * np.sqrt(((moved - mean) ** 2).sum(axis=0) / max(1, len(moved) - 1))
    axes[0].plot(at, demand[:count, axis], color=look.GREY, lw=0.8, label="demand")
    axes[0].plot(at, mean, color=look.DARK, label="master")
    axes[1].fill_between(at, -spread, spread, color=look.BLUE, alpha=0.3, label="repetitions")
    axes[2].plot(at, felt.mean(axis=0), color=look.DARK)
    for one, other in zip(*histories(new), strict=True) if again else ():
        axes[0].plot(at, one, "--", color=look.ORANGE, lw=0.9, label="now")
        axes[1].plot(at, one - mean, color=look.ORANGE, lw=0.7)
        axes[2].plot(at, other, "--", color=look.ORANGE, lw=0.9)
    said = master.bench.tests[name].title.lower()
    axes[0].set_title(f"Motion in {DOFS[axis]}, {said} ({name.replace('_', ' ')})")
    look.legend(figure)
    return figure


def _pictures(master: Master, new: Master) -> dict[str, Figure]:
    """Over-plots of tests, and Bode plots of those with frequency responses, by file."""
    drawn = {}
    for name in [name for name in master.records if name in new.records]:
        drawn[f"{name}.png"] = overplot(master, new, name)
        if "response" in master.bench.tests[name].measures:
            curves: dict[str, Any] = {}
            for when, one in {"": master, ", now": new}.items():
                if not when or new is not master:
                    own, _ = driven_responses(one.records[name][0])
                    curves |= {f"{dof}{when}": response for dof, response in own.items()}
            title = f"Gain and phase, first repetition: {master.bench.tests[name].title.lower()}"
            drawn[f"{name}_bode.png"] = look.bode_figure(title, curves, limits=True)[0]
    return drawn


def _about(master: Master) -> list[Table | str]:
    """What a guide is, on which machine, and its recordings."""
    head, on = master.head, master.bench
    known = ", ".join(f"{key} {value}" for key, value in on.identity.items())
    made = "simulated with noisy electronics" if head.simulated else "recorded"
    rows = []
    for name, one in on.tests.items():
        limit = ", ".join(f"{k} up to {v:g}" for k, v in one.limits.items()) or one.no_limit
        done = str(len(master.records.get(name, ())))
        rows.append((name, one.source, one.conditions, f"{on.used_share[name]:.0%}", done, limit))
    left = list({**on.impossible, **head.left_out}.items())
    columns = ("test", "source", "conditions", "use of limits", "repetitions", "limit, or why none")
    return [
        f"{head.guide.source}. {known}; {made} by version {head.version}.",
        Table("Tests", columns, rows),
        *([Table("Left out", ("test or recording", "why"), left)] if left else []),
        Table("Recordings", ("file", "digest"), list(head.digests.items())),
    ]


def verdict_table(rows: Sequence[Compared]) -> Table:
    """Each test with the worst that its measures say."""
    found = []
    for name, mine in groupby(rows, key=lambda row: row.test):
        odd = [row for row in mine if row.verdict != "as before"]
        said = "; ".join(dict.fromkeys(row.verdict for row in odd)) or "as before"
        found.append((name, said, ", ".join(row.measure for row in odd[:4])))
    return Table("Verdicts", ("test", "verdict", "because of"), found)


def causes_table(causes: Sequence[Cause]) -> Result[Cause]:
    """What most probably changed."""
    return Result(causes, fields_of(Cause), "What most probably changed")


_PAPER = """<!doctype html><meta charset="utf-8"><title>Test guide</title><style>
body { max-width: 60rem; margin: auto; font: 10pt sans-serif }
img { max-width: 100%; break-inside: avoid }
table { border-collapse: collapse; margin: 1em 0 }
td, th { border-top: thin solid silver; padding: 0.1em 0.6em; text-align: left }
</style>
"""


def save_guide(
    master: Master, new: Master, rows: Sequence[Compared], causes: Sequence[Cause], folder: Path
) -> list[Path]:
    """Write `guide.html`, a page that prints, `measures.csv`, `causes.csv` and an over-plot a test.

    `rows` are of `compare`; of a master beside itself the page says what its guide is.
    """
    said = (
        f"found with {master.head.guide.power:.0%}; what is sought takes so many recordings of both"
    )
    measures = Result(rows, fields_of(Compared), "Measures", f"Changes {said}.")
    files: dict[str, Any] = {**_pictures(master, new), "measures.csv": measures}
    tables = [verdict_table(rows), measures.table]
    if causes:
        files["causes.csv"] = causes_table(causes)
        tables.insert(1, causes_table(causes).table)
    about = _about(master) if new is master else [f"{new.folder} against {master.folder}"]
    parts = [f"# {master.head.guide.title}"]
    for part in (*about, *tables):
        parts.append(f"## {part.title}\n\n{part.markdown()}" if isinstance(part, Table) else part)
    parts += [f"![{Path(name).stem}]({name})" for name in files if name.endswith(".png")]
    text = _PAPER + MarkdownIt().enable("table").render("\n\n".join(parts))
    return look.save_files(files | {"guide.html": lambda path: write_text(path, text)}, folder)
