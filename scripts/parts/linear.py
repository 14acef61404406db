"""What the field's ingredients are worth on linear plants: each law, and the same law without it.

Writes `linear.md`: the worst over cabs and valve gains; nothing is tuned anew.
"""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

from cmf_mj import load_law
from cmf_mj.control.law import Law
from cmf_mj.core.result import Table
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.models import CABS
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.studies.tuning.evaluation import LINES, LinearCab, evaluate, linear_cab
from cmf_mj.studies.tuning.search import FASTER, Seeds


def in_all_modes(law: Law, mode: int) -> Law:
    """The law with the gains of one mode for all."""
    direct = law.direct_gain
    alike = {
        name: gains[mode] if isinstance(gains := getattr(direct, name), tuple) else gains
        for name in type(direct).model_fields
    }
    load = law.load_feedback
    changed: dict[str, object] = {"direct_gain": direct.model_copy(update=alike)}
    if load is not None and isinstance(load.gain, tuple):
        changed["load_feedback"] = load.model_copy(update={"gain": load.gain[mode]})
    return law.model_copy(update=changed)


def variants() -> dict[str, Law]:
    """Laws by what is printed of them."""
    pressure, forward, acceleration, modal = (
        load_law(name)
        for name in (
            "dynamic_pressure",
            "feed_forward",
            "acceleration_compensated",
            "modal_feedback",
        )
    )
    deaf = acceleration.direct_gain.model_copy(update={"acceleration": 0.0})
    return {
        "velocity (as flown)": load_law("velocity"),
        "velocity_tuned": load_law("velocity_tuned"),
        pressure.name: pressure,
        "its gains without load pressure": pressure.model_copy(update={"load_feedback": None}),
        acceleration.name: acceleration,
        "its gains without acceleration": acceleration.model_copy(update={"direct_gain": deaf}),
        forward.name: forward,
        "its gains without feed-forward": forward.model_copy(update={"reference_model": None}),
        modal.name: modal,
        "its modes without load pressure": modal.model_copy(update={"load_feedback": None}),
        "its heavy pair's gains in all modes": in_all_modes(modal, 0),
        "its light modes' gains in all modes": in_all_modes(modal, 5),
        "modal_plan": load_law("modal_plan"),
    }


HEADER = ("law", *DOFS, "peak", "overshoot", "tail", f"peak, valves x {FASTER:g}")


def table_of(laws: Mapping[str, Law], cabs: Sequence[LinearCab], seeds: Seeds) -> Table:
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
        nominal = evaluate(law, cabs, seeds)
        faster = evaluate(law, cabs, (None,), scale=FASTER)
        widths = [
            f"> {LINES[-1]:g}" if hz == LINES[-1] else f"{hz:.2f}"
            for hz in nominal.phase_hz.min(axis=(0, 1))
        ]
        shares = [f"{100.0 * part.max():.0f} %" for part in (nominal.overshoot, nominal.tail)]
        peaks = [
            "-" if result.tail.max() > 1.0 else f"{result.peak_db.max():.1f}"
            for result in (nominal, faster)
        ]
        if peaks[0] == "-":
            widths = ["-"] * len(widths)
        lines.append([name, *widths, peaks[0], *shares, peaks[1]])
    return Table("", HEADER, lines)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of the command line."""
    parser.add_argument("--cabs", default=",".join(CABS))
    parser.add_argument("--out", type=Path, default=Path("out/field"))


def run(options: argparse.Namespace) -> None:
    """Write the table."""
    cabs = [linear_cab(Hexapod(cab)) for cab in options.cabs.split(",")]
    table = table_of(variants(), cabs, (None, 1))
    table.save(options.out / "linear.md")
    print(table.markdown())
