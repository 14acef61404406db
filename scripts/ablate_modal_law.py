"""What each ingredient of `modal_plan` is worth: the law without it, on linear plants; Markdown.

Worst over cabs, degrees of freedom and valve gains; nothing is tuned anew.
"""

import argparse
from pathlib import Path

from cmf_mj import load_law
from cmf_mj.control.law import Gains, Law
from cmf_mj.machine.models import CABS
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.studies.tuning.evaluation import evaluate, linear_cab

LEG_MODE = 10.9
"""Mode that a law in legs takes all legs to have, that of heave [Hz]."""


def variants() -> dict[str, Law]:
    """The law, and the law without each ingredient."""
    law = load_law("modal_plan")
    plan = law.plan
    assert plan is not None
    light = {"position": max(plan.position), "velocity": 0.0}  # type: ignore[arg-type]
    free = {"rate": 1e3, "acceleration": 1e6}
    legs = plan.model_copy(update={"frequency": LEG_MODE, **free, **light})

    def with_plan(**changes: object) -> Law:
        return law.model_copy(update={"plan": plan.model_copy(update=changes)})

    gain = plan.position
    feedback_only = {
        "reference": gain,
        "position": tuple(-value for value in gain) if isinstance(gain, tuple) else -gain,
        "error_integral": law.direct_gain.error_integral,
    }
    return {
        "all of it": law,
        "without load feedback": law.model_copy(update={"load_feedback": None}),
        "without lead (velocity 0)": with_plan(velocity=0.0),
        "without both": with_plan(velocity=0.0).model_copy(update={"load_feedback": None}),
        "without bounds on the reference": with_plan(**free),
        "without feedback of position": with_plan(position=0.0),
        "without feed-forward": law.model_copy(
            update={"plan": None, "direct_gain": Gains.model_validate(feedback_only)}
        ),
        f"legs for modes, all at {LEG_MODE:g} Hz": Law(
            name="legs", title="Legs", direct_gain=law.direct_gain, plan=legs
        ),
    }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cabs", default=",".join(CABS))
    parser.add_argument("--out", type=Path, default=Path("out/ablation.md"))
    options = parser.parse_args()
    cabs = [linear_cab(Hexapod(cab)) for cab in options.cabs.split(",")]
    lines = ["| law | -90 | peak | overshoot | off after 0.63 s |", "| --- " * 5 + "|"]
    for name, law in variants().items():
        performance = evaluate(law, cabs, (None, 1))
        lines.append(
            f"| {name} | {performance.phase_hz.min():.2f} | {performance.peak_db.max():.1f} "
            f"| {100.0 * performance.overshoot.max():.0f} % "
            f"| {100.0 * performance.tail.max():.0f} % |"
        )
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
