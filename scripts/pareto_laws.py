"""Draw how much bandwidth what peak and overshoot buy: searches with other limits, linear plants.

Each point is the worst over all cabs, degrees of freedom and valve gains of a law. `front.csv` has
the numbers, `pareto.png` the picture; the report's laws stand beside the front where they are
stable.
"""

import argparse
from pathlib import Path

from matplotlib.figure import Figure

from cmf_mj import load_law
from cmf_mj.core.files import write_csv
from cmf_mj.machine.models import CABS
from cmf_mj.studies.tuning.evaluation import Performance, evaluate
from cmf_mj.studies.tuning.forms import make_template
from cmf_mj.studies.tuning.search import Requirements, search

BESIDE = ("velocity", "model_following")
"""Laws that are stable with every cab."""


def numbers(text: str) -> list[tuple[float, float]]:
    """Pairs of limits, peak [dB] and overshoot [%]."""
    return [(float(a), float(b)) for a, b in (part.split(":") for part in text.split(","))]


def line(name: str, performance: Performance) -> list[object]:
    """Name, -90 deg, peak and overshoot."""
    found = (
        performance.phase_hz.min(),
        performance.peak_db.max(),
        100.0 * performance.overshoot.max(),
    )
    return [name, *(round(float(value), 3) for value in found)]


def main() -> None:
    """Search and draw."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--limits", default="0.5:5,1:10,2:18,3:25", help="dB:%%, ...")
    parser.add_argument("--cabs", default=",".join(CABS))
    parser.add_argument("--evaluations", type=int, default=48)
    parser.add_argument("--out", type=Path, default=Path("out/pareto"))
    options = parser.parse_args()
    template = make_template("front", "Front", options.cabs.split(","))
    seeds = (None, 1)
    rows = [line(name, evaluate(load_law(name), template.cabs, seeds)) for name in BESIDE]
    rows.append(line("modal_plan", evaluate(load_law("modal_plan"), template.cabs, seeds)))
    for peak, overshoot in numbers(options.limits):
        limits = Requirements(peak_db=peak, overshoot=overshoot / 100.0)
        found = search(template, limits, seeds=seeds, evaluations=options.evaluations)
        rows.append(line(f"{peak:g} dB, {overshoot:g} %", found.performance))
        print(*rows[-1], flush=True)
    options.out.mkdir(parents=True, exist_ok=True)
    header = ["law", "phase_hz", "peak_db", "overshoot_percent"]
    write_csv(options.out / "front.csv", header, rows)
    draw(rows).savefig(options.out / "pareto.png", dpi=110)
    print(f"written to {options.out}: front.csv, pareto.png")


def draw(rows: list[list[object]]) -> Figure:
    """Peak and overshoot over the bandwidth."""
    figure = Figure(figsize=(8.0, 3.8), layout="constrained")
    axes = figure.subplots(1, 2)
    front = sorted((row for row in rows if "dB" in str(row[0])), key=lambda row: float(str(row[1])))
    for axis, column, label, limit in (
        (axes[0], 2, "peak gain [dB]", 3.0),
        (axes[1], 3, "overshoot of the step [%]", 25.0),
    ):
        axis.plot([row[1] for row in front], [row[column] for row in front], "o-", label="searched")
        for row in rows:
            if row not in front:
                axis.plot(row[1], row[column], "s", label=str(row[0]).replace("_", " "))
        axis.axhline(limit, color="0.6", linestyle="--", linewidth=1.0)
        axis.axvline(5.0, color="0.6", linestyle="--", linewidth=1.0)
        axis.set(xlabel="-90 deg bandwidth [Hz]", ylabel=label)
        axis.grid(alpha=0.3)
    axes[0].legend(fontsize=8)
    return figure


if __name__ == "__main__":
    main()
