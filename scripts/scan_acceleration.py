"""Which gain of acceleration feedback helps in rotation? Gains beside position error rate feedback.

Writes `gain.md`: by gain and corner of the accelerometer's filter, the least damping ratio of all
modes with each cab, and the worst -90 deg bandwidth and peak in rotation. Nominal machines, by the
poles and responses of `cmf study` with method linear.
"""

import argparse
from pathlib import Path

import numpy as np

from cmf_mj import load_law
from cmf_mj.control.law import Law
from cmf_mj.core.rates import FRAME
from cmf_mj.machine.models import CABS
from cmf_mj.show.table import Table
from cmf_mj.studies.evaluation import StudyRow, evaluate
from cmf_mj.studies.settings import load_study

ROTATIONS = ("roll", "pitch", "yaw")


def law_of(gain: float, corner: float | None) -> Law:
    """Position error rate feedback with a gain [%/(in/s^2)] behind a corner [Hz]; None: Eq 3.6."""
    law = load_law("position_error_rate")
    changes: dict[str, object] = {
        "name": f"{gain:g} at {corner}",
        "direct_gain": law.direct_gain.model_copy(update={"acceleration": gain}),
    }
    if corner is not None:
        pole = float(np.exp(-2.0 * np.pi * corner * FRAME))
        changes |= {"accelerometer_pole": pole, "accelerometer_gain": 1.0 - pole}
    return law.model_copy(update=changes)


def worst(rows: list[StudyRow]) -> list[str]:
    """Worst bandwidth of each rotation and worst peak of them over the cabs; a dash if unstable."""
    if not all(row.measures.stable for row in rows):
        return ["-"] * (len(ROTATIONS) + 1)
    by_dof = [
        [row.measures.phase_bandwidth_hz for row in rows if row.dof == dof] for dof in ROTATIONS
    ]
    peak = max(row.measures.peak_gain_db for row in rows if row.dof in ROTATIONS)
    return [*(f"{min(found):.2f}" for found in by_dof), f"{peak:.1f}"]


def main() -> None:
    """Scan and write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--gains", default="0.01,0,-0.01,-0.03,-0.05,-0.08,-0.12")
    parser.add_argument("--corners", default="0,8,30", help="Hz; 0 for that of Eq 3.6, 2.5 Hz")
    parser.add_argument("--cabs", default=",".join(CABS))
    parser.add_argument("--out", type=Path, default=Path("out/acceleration"))
    options = parser.parse_args()
    cabs = options.cabs.split(",")
    laws = [
        law_of(float(gain), float(corner) or None)
        for corner in options.corners.split(",")
        for gain in options.gains.split(",")
    ]
    study = load_study(
        {"title": "gains", "method": "linear", "laws": ["velocity"], "cabs": cabs}, laws=laws
    )
    found: dict[str, list[StudyRow]] = {law.name: [] for law in laws}
    for case in study.cases:
        found[case.case.law.name] += evaluate(case)
    lines = []
    for name, rows in found.items():
        gain, corner = name.split(" at ")
        damping = [f"{row.measures.mode_damping_ratio:.3f}" for row in rows if row.dof == "roll"]
        lines.append(
            [gain, "2.5" if corner == "None" else f"{float(corner):g}", *damping, *worst(rows)]
        )
    header = (
        "gain [%/(in/s²)]",
        "corner [Hz]",
        *(f"damping {cab}" for cab in cabs),
        *ROTATIONS,
        "peak [dB]",
    )
    print(Table("", header, lines).save(options.out / "gain.md"))


if __name__ == "__main__":
    main()
