"""Tables of what laws are worth on linear plants, as Markdown."""

from collections.abc import Mapping, Sequence

from cmf_mj.control.law import Law
from cmf_mj.machine.kinematics import DOFS
from cmf_mj.show.comparison import markdown
from cmf_mj.studies.tuning.evaluation import LINES, LinearCab, evaluate
from cmf_mj.studies.tuning.search import FASTER, Seeds

HEADER = ("law", *DOFS, "peak", "overshoot", "tail", f"peak, valves x {FASTER:g}")


def worth_table(laws: Mapping[str, Law], cabs: Sequence[LinearCab], seeds: Seeds) -> str:
    """Worst over cabs and valve gains, a line a law.

    The -90 deg bandwidth [Hz] of each degree of freedom; of all of them the largest peak [dB],
    overshoot and distance from the demand after 0.63 s; the peak with faster valves. A dash where
    that distance is more than the step was: such a loop has no response to measure.

    Args:
        laws: by the name to print.
        cabs: linear plants.
        seeds: of the valve gains; None for the nominal ones.
    """
    lines = []
    for name, law in laws.items():
        worth = evaluate(law, cabs, seeds)
        faster = evaluate(law, cabs, (None,), scale=FASTER)
        widths = [
            f"> {LINES[-1]:g}" if hz == LINES[-1] else f"{hz:.2f}"
            for hz in worth.phase_hz.min(axis=(0, 1))
        ]
        shares = [f"{100.0 * part.max():.0f} %" for part in (worth.overshoot, worth.settled)]
        peaks = [
            "-" if found.settled.max() > 1.0 else f"{found.peak_db.max():.1f}"
            for found in (worth, faster)
        ]
        if peaks[0] == "-":
            widths = ["-"] * len(widths)
        lines.append([name, *widths, peaks[0], *shares, peaks[1]])
    return markdown(HEADER, lines)
