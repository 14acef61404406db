"""What each ingredient of `modal_plan` does: the law without it, nothing tuned again.

Simulated with the IFD, the `hardware` set with the valve gains of one seed, noisy electronics and
quick sweeps: the worst of surge, heave and roll at neutral, of the same in two corners of the
envelope, and surge at three times the report's amplitude. Stiffness is the least share of the
velocity law's from 0.5 to 5 Hz of all axes, linearised at neutral. Writes `ablation.md`.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from cmf_mj import Hexapod, load_hydraulics, load_law, simulate
from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.analysis.measures import Measures, measure_records
from cmf_mj.control.law import Gains, Law
from cmf_mj.core.result import Table
from cmf_mj.core.threads import on_threads
from cmf_mj.core.units import RATE
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.facility.unknowns import with_valve_gains
from cmf_mj.studies.case import Case, dof_amplitude, make_case
from parts.accept import poses

CAB, SEED = "ifd", 1

CORNERS = (13, 18)
"""Two of `accept.poses`, which lean to opposite sides."""

LEG_MODE = 10.9
"""Mode that a law in legs takes all legs to have, that of heave [Hz]."""

COLUMNS = (
    *("law", ("-90", ".2f"), ("peak", ".1f"), ("overshoot", ".0f %")),
    *(("-90, corners", ".2f"), ("peak, corners", ".1f"), ("overshoot, corners", ".0f %")),
    *(("-90, three times", ".2f"), ("stiffness", ".2f"), ("noise to valve", ".2f %")),
)


def variants() -> dict[str, Law]:
    """The law, and the law without each ingredient."""
    law = load_law("modal_plan")
    plan = law.plan
    assert plan is not None
    free = {"rate": 1e3, "acceleration": 1e6, "smooth": 1e3}
    light = {"position": max(plan.position), "velocity": 0.0}  # type: ignore[arg-type]
    legs = plan.model_copy(update={"frequency": LEG_MODE, **free, **light})
    still = {name: one.model_copy(update={"follow_pose": False}) for name, one in law.modes.items()}

    def with_plan(**changes: object) -> Law:
        return law.model_copy(update={"plan": plan.model_copy(update=changes)})

    gain = plan.position
    feedback_only = {
        "reference": gain,
        "position": tuple(-value for value in gain) if isinstance(gain, tuple) else -gain,
        "error_integral": law.direct_gain.error_integral,
    }
    no_integral = law.direct_gain.model_copy(update={"error_integral": 0.0})
    return {
        "all of it": law,
        "masses and oil do not follow the pose": law.model_copy(update={"modes": still}),
        "valves do not know their load": with_plan(stall=None),
        "no bound on jerk": with_plan(smooth=1e3),
        "no bounds on the reference": with_plan(**free),
        "no load feedback": law.model_copy(update={"load_feedback": None}),
        "no lead": with_plan(velocity=0.0),
        "neither": with_plan(velocity=0.0).model_copy(update={"load_feedback": None}),
        "no integral": law.model_copy(update={"direct_gain": no_integral}),
        "no feedback of position": with_plan(position=0.0),
        "no feed-forward": law.model_copy(
            update={"plan": None, "direct_gain": Gains.model_validate(feedback_only)}
        ),
        f"legs for modes, all at {LEG_MODE:g} Hz": Law(
            name="legs", title="Legs", direct_gain=law.direct_gain, plan=legs
        ),
    }


def cases(law: Law, dofs: list[str]) -> list[Case]:
    """Those at neutral, those in corners, and surge at three times the amplitude."""
    hydraulics = with_valve_gains(load_hydraulics("hardware"), SEED)
    more: dict[str, Any] = {"electronics": ElectronicsSettings(), "quick": True}
    machine: tuple[Any, ...] = ("hexapod", CAB, hydraulics)
    places = [(0.0,) * 6, *(poses()[number] for number in CORNERS)]
    at = [make_case(law, dof, *machine, pose=pose, **more) for pose in places for dof in dofs]
    return [*at, make_case(law, dofs[0], *machine, amplitude=3 * dof_amplitude(dofs[0]), **more)]


def measured(case: Case) -> Measures:
    """Chirp and step."""
    return measure_records(*case.sweep_and_step(), segment=case.segment)


def worst(found: list[Measures]) -> list[float | str]:
    """Lowest -90 deg, largest peak and overshoot; what is unstable says so."""
    if not all(one.stable for one in found):
        return ["unstable", np.nan, np.nan]
    phase, peak, over = np.array([[*one[:1], one[2], one.overshoot] for one in found]).T
    return [float(np.nanmin(phase)), float(peak.max()), 100.0 * float(over.max())]


def row(name: str, law: Law, dofs: list[str], jobs: int) -> list[float | str]:
    """A line of the table."""
    linear, hertz = Linear(Hexapod(CAB, "hardware")), np.linspace(0.5, 5.0, 19)
    found = on_threads(measured, cases(law, dofs), jobs)
    count = len(dofs)
    neutral, corners = worst(found[:count]), worst(found[count:-1])
    rest = simulate(linear.plant, law, np.zeros((3 * RATE, 6)), electronics="noisy")
    noise = float(rest["valve_command"][RATE:].std(axis=0).max())
    share: float | str = "-"
    if found[0].stable:
        own, flown = (linear.stiffness(one, hertz) for one in (law, "velocity"))
        share = float((own / flown).min())
    return [name, *neutral, *corners, worst(found[-1:])[0], share, 100.0 * noise]


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of the command line."""
    parser.add_argument("--dofs", default="surge,heave,roll")
    parser.add_argument("--only", default="", help="variants, by how they begin")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("out/modal_plan"))


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    only, dofs = tuple(options.only.split(",")), options.dofs.split(",")
    chosen = {name: law for name, law in variants().items() if name.startswith(only)}
    rows = []
    for name, law in chosen.items():
        rows.append(row(name, law, dofs, options.jobs))
        print(*rows[-1], flush=True)
    table = Table("", COLUMNS, rows)
    table.save(options.out / "ablation.md")
    print(table.markdown())
