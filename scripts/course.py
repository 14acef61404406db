"""Numbers, figures and time series of the course, docs/tutorials/why_surge_shakes.md and on.

    python scripts/course.py [--out out/course]

The closed form of one leg is docs/_static/course/by_hand.py. `legs.csv` has its numbers in heave
and in surge, `leg_values.csv` what it is given, `leg_mass.csv` the mass that a leg feels step by
step, `leg_gains.csv` what a gain on acceleration does, `leg_fit.csv` what the recorded step gives,
`step_surge.csv` and `step_heave.csv` what the simulation does, `*-metadata.json` their
columns as CSV on the Web (W3C). `scripts/update_docs.py` takes all of them.
"""

import argparse
import csv
import io
import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from cmf_mj import Hexapod, Law, Linear, load_hydraulics, load_law, load_scenario
from cmf_mj.core import units
from cmf_mj.core.units import INCH, RATE
from cmf_mj.machine.kinematics import leg_jacobian
from cmf_mj.show.look import save_figure

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "docs/_static/course"))
from by_hand import (
    WITHIN,
    calm,
    fitted,
    given,
    leg,
    misfit,
    one,
    payload,
    peaks,
    polynomial,
    right,
    series,
    surge,
    tops,
)

EVERY = 16  #: Frames from row to row of the time series: 128 a second.
SECONDS = 4.0  #: Of each time series.
COURSE = Path(__file__).resolve().parents[1] / "docs/_static/course"
LESSONS = ("why_surge_shakes", "acceleration_feedback", "recording_to_law")
COLUMNS = {
    "time_s": ("time", 0, "s", "Time; the step is demanded at 1 s"),
    "demand_m": ("demand_pose", None, "m", "Pose demanded, along the axis of the file"),
    "response_m": ("platform_pose", None, "m", "Pose of the platform along that axis"),
    "leg_2_m": ("leg_extension", 1, "m", "Extension of leg 2 from neutral, positive out"),
    "leg_2_cap_Pa": ("cap_pressure", 1, "Pa", "Cap pressure of leg 2, gauge; extends the leg"),
    "leg_2_rod_Pa": ("rod_pressure", 1, "Pa", "Rod pressure of leg 2, gauge; retracts the leg"),
    "leg_2_valve": ("valve_command", 1, "1", "Command of leg 2, fraction of full; extends"),
}


def _csv(rows: list[tuple[str, ...]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def legs(folder: Path) -> str:
    """Both legs by hand as CSV, and what the steps in `folder` count to."""
    found, of = Hexapod("gfd").hydraulic_modes(), given()
    lines = [
        "leg,mass [kg],mass [lbm],rings at [Hz],-90 deg [Hz],peak [dB],swings at [Hz],damping,"
        "margin [dB],counted [Hz],rests at [in],oil swings at [Hz],its damping"
    ]
    for name, mode in (("heave", 3), ("surge", 0)):
        mass = float(found.leg_mass[mode])
        one = leg(mass, of)
        time, response = series(name, folder)
        first, second, *_ = time[tops(response)]
        cells = f"{mass:.0f},{units.from_si('lbm', mass):.0f},{one['ring']:.2f},{one['lag90']:.2f}"
        cells += f",{one['peak']:.1f},{one['swing']:.2f},{one['damping']:.2f},{one['margin']:.1f}"
        cells += f",{1.0 / (second - first):.1f},{response[-1]:.2f}"
        fast = max(np.roots(polynomial(mass, of)), key=abs)
        swing = f"{abs(fast.imag) / (2.0 * np.pi):.1f},{-fast.real / abs(fast):.2f}"
        lines.append(f"{name},{cells},{swing}")
    return "\n".join(lines) + "\n"


def values() -> str:
    """What the closed form is given, as CSV."""
    oil, of, lean = load_hydraulics("hardware"), given(), np.degrees(np.arccos(cosine()))
    beta = oil.bulk_modulus.si / units.PSI
    rows = [
        ("β", "bulk modulus of the oil", f"{beta:.0f}", "psi"),
        ("A_c", "area of the piston, cap side", f"{oil.cap_area / INCH**2:.2f}", "in²"),
        ("A_r", "area of the piston, rod side", f"{oil.rod_area / INCH**2:.2f}", "in²"),
        ("h", "half stroke", f"{oil.half_stroke.si / INCH:.2f}", "in"),
        ("M", "platform and cab", f"{units.from_si('lbm', payload()):.0f}", "lbm"),
        ("θ", "lean of a leg from the vertical", f"{lean:.2f}", "deg"),
        ("τ", "lag of the valve's drive", f"{1e3 * of.tau:.2f}", "ms"),
        ("λ", "rate of the leak", f"{of.rate:.0f}", "1/s"),
        ("σ", "speed of a leg for 1 % of command", f"{of.speed:.3f}", "in/s/%"),
        ("g", "gain on position", f"{of.gain:.2f}", "%/in"),
        ("a", "gain on acceleration", f"{of.acceleration:.5f}", "%/(in/s²)"),
        ("b", "gain on force", f"{of.load:.3e}", "%/(in/s²)/kg"),
    ]
    scale = {
        "psi": 1e-6 * units.PSI,
        "in²": INCH**2,
        "in": INCH,
        "lbm": units.factor("lbm"),
        "ms": 1e-3,
    }
    si = {"psi": "MPa", "in²": "m²", "in": "m", "lbm": "kg", "ms": "s"}
    also = [
        f"{float(row[2]) * scale[row[3]]:.5g} {si[row[3]]}" if row[3] in si else "" for row in rows
    ]
    whole = [(*row, one) for row, one in zip(rows, also, strict=True)]
    return _csv([("symbol", "is", "value", "unit", "SI"), *whole])


def cosine() -> float:
    """Of the lean of a leg at neutral: its stretch for a unit of heave."""
    return float(np.abs(leg_jacobian(np.zeros(6))[:, 2]).mean())


def masses() -> str:
    """The mass that a leg feels [lbm], by hand, with the legs' own, and in the modes, as CSV."""
    plant, jacobian = Hexapod("gfd"), leg_jacobian(np.zeros(6))
    whole = np.diag(jacobian.T @ plant.reflected_mass() @ jacobian) / (jacobian**2).sum(axis=0)
    modes, square = plant.hydraulic_modes().leg_mass, cosine() ** 2
    rows = [
        ("platform and cab, by hand", payload() / (6 * square), payload() / (3 * (1 - square))),
        ("with the legs' own mass", whole[2], whole[0]),
        ("and free to pitch, the modes", modes[3], modes[0]),
    ]
    header = ("a leg carries", "heave [lbm]", "surge [lbm]", "ratio")
    cells = [(row[0], *(f"{units.from_si('lbm', m):.0f}" for m in row[1:])) for row in rows]
    ratios = [f"{surge / heave:.1f}" for _, heave, surge in rows]
    return _csv([header, *((*one, ratio) for one, ratio in zip(cells, ratios, strict=True))])


def changed(gain: float, acceleration: float) -> Law:
    """The velocity law with other gains on a leg's position at rest and on its acceleration."""
    law, of = load_law("velocity"), given()
    direct, share = law.direct_gain, gain / of.gain
    gains = {
        "position": np.add(direct.position, of.gain - gain),
        "reference": np.multiply(direct.reference, share),
        "acceleration": of.acceleration - acceleration,
    }
    return law.model_copy(update={"direct_gain": direct.model_copy(update=gains)})


def rests() -> float:
    """Where the velocity law rests over its demand [dB]."""
    return float(20.0 * np.log10(one(load_law("velocity").direct_gain.reference) / given().gain))


def gains() -> str:
    """What a gain on acceleration does in surge, by hand and on the machine in small motion.

    Peaks are over where the machine rests.
    """
    linear, of = Linear(Hexapod("gfd")), given()
    mass = surge()
    rows = []
    for gain in (of.acceleration, 0.03, 0.05, 0.1, 0.13, 0.2):
        hand, law = leg(mass, of._replace(acceleration=gain)), changed(of.gain, gain)
        found = linear.measures(law)[0]
        least = f"{found.mode_damping_ratio:.3f}", f"{found.mode_frequency_hz:.1f}"
        machine = [f"{found.peak_gain_db - rests():.1f}", f"{found.phase_bandwidth_hz:.2f}"]
        cells = [f"{hand['peak']:.1f}", *(machine if found.stable else ("-", "-"))]
        rows.append((f"{gain:.3f}", *cells[:2], f"{hand['lag90']:.2f}", *cells[2:], *least))
    header = ("a [%/(in/s²)]", "peak by hand [dB]", "machine [dB]", "-90 deg by hand [Hz]")
    return _csv([(*header, "machine [Hz]", "least damping", "of its mode at [Hz]"), *rows])


def fit() -> str:
    """What the recorded step gives: a mass, what is left, and a gain for it."""
    of, linear = given(), Linear(Hexapod("gfd"))
    left, found = (
        misfit(fitted(), of, *series("surge")),
        linear.measures(changed(calm(), of.acceleration)),
    )
    true = calm(of=surge())
    missed = linear.measures(changed(true, of.acceleration))[0].peak_gain_db - rests()
    header = "of,mass [kg],too large [%],left rms [in],gain [%/in],peak [dB],-90 deg [Hz]"
    header += ",gain of the true mass [%/in],its peak [dB]"
    cells = (
        f"{fitted():.0f},{100.0 * (fitted() / surge() - 1.0):.0f},{np.sqrt(np.mean(left**2)):.2f}"
    )
    law = f"{calm():.1f},{found[0].peak_gain_db - rests():.1f},{found[0].phase_bandwidth_hz:.2f}"
    law += f",{true:.1f},{missed:.1f}"
    return f"{header}\nstep in surge,{cells},{law}\n"


def exercises() -> str:
    """The exercises of the notebooks with what is right, as the line of exercises.html."""
    cells = [
        "".join(cell["source"])
        for name in LESSONS
        for cell in json.loads((COURSE / f"{name}.ipynb").read_text(encoding="utf-8"))["cells"]
        if cell["cell_type"] == "markdown"
    ]
    words = dict(re.findall(r"^(\d+): (.*)", "\n".join(cells), re.MULTILINE))
    asked = re.findall(r"## (\d+)\n\n\*\*(.*?)\*\* (.*)", "\n".join(cells))
    rows = [
        {"number": int(number), "title": title, "question": question.replace("*", "")}
        # Ten digits: the last ones hang on the processor.
        | {"right": float(f"{found:.10g}"), "unit": unit, "hint": hint}
        | {"within": WITHIN.get(int(number), 0.02), "answer": words.get(number, "")}
        for number, title, question in asked
        for found, unit, hint in (right()[int(number)],)
    ]
    return f"const EXERCISES = {json.dumps(rows, ensure_ascii=False, default=float)};"


def recorded() -> str:
    """The simulated step in surge over where it rests, as the line of leg.html."""
    time, response = series("surge")
    swing, rest = (time > 1.0) & (time < 2.5), response[time > 3.5].mean()
    points = [[round(t - 1.0, 6), round(x, 4)] for t, x in zip(time, response / rest, strict=True)]
    kept = [point for point, inside in zip(points, swing, strict=True) if inside]
    return f"const RESTS = {rest:.4f}, RECORDED = {json.dumps(kept)};"


def pages(folder: Path) -> None:
    """The pages of the course with their lines."""
    for name, line in (("exercises", exercises()), ("leg", recorded())):
        text = (COURSE / f"{name}.html").read_text(encoding="utf-8")
        start = line.split(" = ")[0] + " ="
        found = [line if one.startswith(start) else one for one in text.split("\n")]
        (folder / f"{name}.html").write_text("\n".join(found), encoding="utf-8")


def draw(folder: Path) -> None:
    """Peak over the gain on acceleration; the recorded step, the fitted one and what is left."""
    of, linear = given(), Linear(Hexapod("gfd"))
    figure = Figure(figsize=(7.0, 3.2), layout="constrained")
    axis, tried = figure.subplots(), np.geomspace(of.acceleration, 1.0, 60)
    machine = [linear.measures(changed(of.gain, gain))[0] for gain in tried]
    axis.semilogx(tried, peaks(surge(), of, "acceleration", tried), label="by hand")
    over = [found.peak_gain_db - rests() for found in machine]
    axis.semilogx(tried, over, label="machine over where it rests, while stable")
    ends = tried[[not found.stable for found in machine].index(True)]
    axis.axvline(ends, color="0.6", linestyle=":", label="a mode at 14 Hz is unstable beyond")
    axis.set(xlabel="gain on acceleration [%/(in/s²)]", ylabel="peak in surge [dB]")
    ticks = [0.013, 0.03, 0.05, 0.1, 0.2, 0.5, 1.0]
    axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axis.minorticks_off()
    axis.legend()
    save_figure(figure, folder / "gains.png")
    figure = Figure(figsize=(7.0, 3.2), layout="constrained")
    axis, (time, response) = figure.subplots(), series("surge")
    seen = (time > 1.0) & (time < 2.5)
    left = misfit(fitted(), of, time, response)
    axis.plot(time[seen], response[seen], label="recorded")
    axis.plot(time[seen], response[seen] - left, label="by hand, mass fitted")
    axis.plot(time[seen], left, label="what is left")
    axis.set(xlabel="time [s]", ylabel="surge [in]")
    axis.legend()
    save_figure(figure, folder / "fit.png")


def save_step(axis: int, name: str, folder: Path) -> None:
    """A step of 1 in under the velocity law as CSV, with its data dictionary."""
    run = load_scenario(f"{name}_ring")
    record = run.model_copy(update={"law": "velocity", "duration": SECONDS}).record()
    rows = slice(None, None, EVERY)
    values = []
    for channel, column, _, _ in COLUMNS.values():
        of = record.time if channel == "time" else record[channel]
        values.append(of.reshape(len(of), -1)[rows, axis if column is None else column])
    path = folder / f"step_{name}.csv"
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerows(
            [COLUMNS, *([f"{v:.9g}" for v in row] for row in zip(*values, strict=True))]
        )
    columns: list[dict[str, Any]] = [
        {"name": key, "datatype": "number", "dc:description": said, "schema:unitText": unit}
        for key, (_, _, unit, said) in COLUMNS.items()
    ]
    for entry in columns[1:3]:
        entry["dc:description"] += f", positive {('forward', 'right', 'down')[axis]}"
    table = {
        "@context": "http://www.w3.org/ns/csvw",
        "url": path.name,
        "dc:title": f"Step of 1 in along {name}, GFD, velocity law, {RATE // EVERY} Hz",
        "dc:description": f'scenarios/{name}_ring.toml with law = "velocity": scripts/course.py',
        "tableSchema": {"columns": columns, "primaryKey": "time_s"},
    }
    text = json.dumps(table, indent=2, ensure_ascii=False) + "\n"
    (folder / f"step_{name}.csv-metadata.json").write_text(text, encoding="utf-8")


def main() -> None:
    """Write all files."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/course"), metavar="FOLDER")
    folder: Path = parser.parse_args().out
    folder.mkdir(parents=True, exist_ok=True)
    for axis, name in ((0, "surge"), (2, "heave")):
        save_step(axis, name, folder)
    draw(folder)
    pages(folder)
    made = {"legs": legs(folder), "leg_values": values(), "leg_mass": masses()}
    made |= {"leg_gains": gains(), "leg_fit": fit()}
    for name, text in made.items():
        (folder / f"{name}.csv").write_text(text, encoding="utf-8")
    print(f"written to {folder}: {', '.join(made)}, step_surge, step_heave, dictionaries, figures")


if __name__ == "__main__":
    main()
