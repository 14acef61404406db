"""Tables, figures and files of measured responses, and of test guides."""

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from markdown_it import MarkdownIt
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cmf_mj.analysis.frequency_response import FrequencyResponse, bandwidths
from cmf_mj.analysis.measurable import LEAST_COHERENCE
from cmf_mj.analysis.measures import measures_from
from cmf_mj.core.files import write_text
from cmf_mj.core.result import Field, Result, Table, fields_of, lines
from cmf_mj.machine.geometry import DOFS, by_kind
from cmf_mj.machine.kinematics import legs_to_pose
from cmf_mj.show import look
from cmf_mj.studies.diagnosis import Cause
from cmf_mj.studies.guide_check import Compared, Master
from cmf_mj.studies.measurement import RecordingMeasures, accelerations, driven_responses

Array = NDArray[np.float64]

RESPONSE_FIELDS = tuple(
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


def response_table(measures: RecordingMeasures) -> Table:
    """Bandwidths, peak and coherence of the response that recordings show."""
    response = measures.response
    least_coherence = response.coherence.min()
    values = {"measures": measures_from(bandwidths(response)), "coherence": least_coherence}
    rows = lines(values, RESPONSE_FIELDS)
    title = f"{measures.dof}: {', '.join(path.name for path in measures.files)}"
    reason = f"not excited, or of a coherence below {LEAST_COHERENCE:g}"
    rows.append(("lines left out", str(measures.left_out), reason))
    return Table(title, ("measure", "value", "definition"), rows)


def response_figure(title: str, name: str, response: FrequencyResponse) -> Figure:
    """Gain and phase of a measured response with their 95 % bounds, and its coherence."""
    labels, ratios = ("gain [dB]", "phase [deg]", "coherence"), (3, 3, 1)
    figure, axes = look.stack(8.0, 8.0, *labels, x="frequency [Hz]", ratios=ratios)
    gain, phase, coherence = axes
    look.style_bode(gain, phase, title, limits=True)
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
    table = response_table(measures)
    files = {"response.csv": columns, "response.png": figure, "measures.csv": table}
    return look.save_files(files, folder)


def _histories(master: Master, name: str, dof: int, count: int) -> tuple[Array, Array]:
    """Motion and acceleration in one degree of freedom in the repetitions of a test, (n, count)."""
    records, machine = master.records[name], master.bench.plant.machine
    motion = [legs_to_pose(record["leg_position"], machine)[:count, dof] for record in records]
    acceleration = [accelerations(record)[:count, dof] for record in records]
    return np.array(motion), np.array(acceleration)


def _main_dof(demand: Array) -> int:
    """Index of the degree of freedom that a demand moves most, of translations if any moves."""
    reach = np.ptp(demand, axis=0)
    translation, rotation = np.split(reach, 2)
    if translation.max() > 0.1 * rotation.max():
        return int(np.argmax(translation))
    return len(translation) + int(np.argmax(rotation))


def overplot_figure(master: Master, new: Master, name: str) -> Figure:
    """A test in its main degree of freedom: motion, motion less the master's mean, acceleration.

    The band is twice the deviation of the master's repetitions.
    """
    first = master.records[name][0]
    demand = legs_to_pose(first["leg_reference"], master.bench.plant.machine)
    dof = _main_dof(demand)
    unit, is_compared = by_kind(dof, "m", "rad"), new is not master
    difference = "now less master" if is_compared else "repetitions less mean"
    labels = (f"{DOFS[dof]} [{unit}]", f"{difference} [{unit}]", f"acceleration [{unit}/s^2]")
    figure, (motion, deviation, acceleration) = look.stack(8.0, 6.5, *labels)
    count = min(len(record.time) for record in (*master.records[name], *new.records[name]))
    time = first.time[:count]
    master_motions, master_accelerations = _histories(master, name, dof, count)
    mean, freedom = master_motions.mean(axis=0), max(1, len(master_motions) - 1)
    band = 2.0 * np.sqrt(((master_motions - mean) ** 2).sum(axis=0) / freedom)
    motion.plot(time, demand[:count, dof], color=look.GREY, lw=0.8, label="demand")
    motion.plot(time, mean, color=look.DARK, label="master")
    deviation.fill_between(time, -band, band, color=look.BLUE, alpha=0.3, label="repetitions")
    acceleration.plot(time, master_accelerations.mean(axis=0), color=look.DARK)
    if is_compared:
        for new_motion, new_acceleration in zip(*_histories(new, name, dof, count), strict=True):
            motion.plot(time, new_motion, "--", color=look.ORANGE, lw=0.9, label="now")
            deviation.plot(time, new_motion - mean, color=look.ORANGE, lw=0.7)
            acceleration.plot(time, new_acceleration, "--", color=look.ORANGE, lw=0.9)
    title = master.bench.tests[name].title.lower()
    motion.set_title(f"Motion in {DOFS[dof]}, {title} ({name.replace('_', ' ')})")
    look.legend(figure)
    return figure


def _guide_figures(master: Master, new: Master) -> dict[str, Figure]:
    """Over-plots of tests, and Bode plots of those with frequency responses, by file."""
    figures = {}
    for name in [name for name in master.records if name in new.records]:
        figures[f"{name}.png"] = overplot_figure(master, new, name)
        test = master.bench.tests[name]
        if "response" in test.measures:
            curves, _ = driven_responses(master.records[name][0])
            if new is not master:
                responses, _ = driven_responses(new.records[name][0])
                curves |= {f"{dof}, now": response for dof, response in responses.items()}
            title = f"Gain and phase, first repetition: {test.title.lower()}"
            figures[f"{name}_bode.png"] = look.bode_figure(title, curves, limits=True)[0]
    return figures


def _description(master: Master) -> list[Table | str]:
    """What a guide is, on which machine, its tests and recordings."""
    head, bench = master.head, master.bench
    machine = ", ".join(f"{key} {value}" for key, value in bench.identity.items())
    origin = "simulated with noisy electronics" if head.simulated else "recorded"
    rows = []
    for name, test in bench.tests.items():
        limits = [f"{measure} up to {limit:g}" for measure, limit in test.limits.items()]
        limit_text = ", ".join(limits) or test.no_limit
        count = str(len(master.records.get(name, ())))
        rows.append(
            (name, test.source, test.conditions, f"{bench.used_share[name]:.0%}", count, limit_text)
        )
    left_out = list({**bench.impossible, **head.left_out}.items())
    columns = ("test", "source", "conditions", "use of limits", "repetitions", "limit, or why none")
    return [
        f"{head.guide.source}. {machine}; {origin} by version {head.version}.",
        Table("Tests", columns, rows),
        *([Table("Left out", ("test or recording", "why"), left_out)] if left_out else []),
        Table("Recordings", ("file", "digest"), list(head.digests.items())),
    ]


def verdict_table(rows: Sequence[Compared]) -> Table:
    """Each test with the verdicts of its measures that are not as before."""
    cells = []
    for test, measures in groupby(rows, key=lambda row: row.test):
        changed = [row for row in measures if row.verdict != "as before"]
        verdicts = "; ".join(dict.fromkeys(row.verdict for row in changed)) or "as before"
        cells.append((test, verdicts, ", ".join(row.measure for row in changed[:4])))
    return Table("Verdicts", ("test", "verdict", "because of"), cells)


def causes_table(causes: Sequence[Cause]) -> Result[Cause]:
    """What most probably changed."""
    return Result(causes, fields_of(Cause), "What most probably changed")


_PAGE_HEAD = """<!doctype html><meta charset="utf-8"><title>Test guide</title><style>
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
    caption = (
        f"Changes found with {master.head.guide.power:.0%}; what is sought takes so many "
        "recordings of both."
    )
    measures = Result(rows, fields_of(Compared), "Measures", caption)
    files: dict[str, Any] = {**_guide_figures(master, new), "measures.csv": measures}
    tables = [verdict_table(rows), measures.table]
    if causes:
        files["causes.csv"] = causes_table(causes)
        tables.insert(1, causes_table(causes).table)
    description = (
        _description(master) if new is master else [f"{new.folder} against {master.folder}"]
    )
    blocks = [f"# {master.head.guide.title}"]
    for block in (*description, *tables):
        is_table = isinstance(block, Table)
        blocks.append(f"## {block.title}\n\n{block.markdown()}" if is_table else block)
    blocks += [f"![{Path(name).stem}]({name})" for name in files if name.endswith(".png")]
    text = _PAGE_HEAD + MarkdownIt().enable("table").render("\n\n".join(blocks))
    return look.save_files(files | {"guide.html": lambda path: write_text(path, text)}, folder)
