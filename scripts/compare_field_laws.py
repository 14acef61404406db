"""What the field's ingredients are worth on linear plants: each law, and the same law without it.

Writes `linear.md`: the worst over cabs and valve gains; nothing is tuned anew.
"""

import argparse
from pathlib import Path

from cmf_mj import load_law
from cmf_mj.control.law import Law
from cmf_mj.core.files import whole_file
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.show.tuning import worth_table
from cmf_mj.studies.tuning.evaluation import linear_cab
from cmf_mj.studies.tuning.nominal import CABS


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


def main() -> None:
    """Write the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cabs", default=",".join(CABS))
    parser.add_argument("--out", type=Path, default=Path("out/field"))
    options = parser.parse_args()
    cabs = [linear_cab(Hexapod(cab)) for cab in options.cabs.split(",")]
    table = worth_table(variants(), cabs, (None, 1))
    with whole_file(options.out / "linear.md") as path:
        path.write_text(table, encoding="utf-8")
    print(table)


if __name__ == "__main__":
    main()
