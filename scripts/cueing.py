"""Families of washouts side by side: `python scripts/cueing.py [--tune N]`.

Writes `cueing.csv`: a row for each manoeuvre and family, with the measures of `judge` and the
largest share of any limit. Manoeuvres are the shipped flights and drives; the classical washout is
tuned on those of `TUNED` only, by covariance matrix adaptation of gains and corners, within the
limits; the others are held out. Without `--tune` it is `cueing_tuned.toml`, of 900 evaluations.
"""

import argparse
import csv
from collections.abc import Mapping
from pathlib import Path

import cma
import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.settings import validated
from cmf_mj.pilot.cueing import DRIVES, Cue, cue, drive, judge
from cmf_mj.pilot.flight import flight_names, load_flight
from cmf_mj.pilot.motion import PilotMotion
from cmf_mj.pilot.washout_settings import (
    ClassicalSettings,
    PredictiveSettings,
    WashoutSettings,
    load_washout,
    save_washout,
)

TUNED = ("turn", "gusts", "approach", "lane_change", "braking")
"""Manoeuvres on which the classical washout is tuned."""

_CORNERS = (
    *((dof, "gain") for dof in ("surge", "sway", "heave", "roll", "pitch", "yaw")),
    *((dof, "natural_frequency") for dof in ("surge", "sway", "heave", "roll", "pitch", "yaw")),
    *((dof, "low_pass_frequency") for dof in ("surge", "sway")),
    ("heave", "break_frequency"),
)


def manoeuvre(name: str) -> PilotMotion:
    """A flight or a drive by name."""
    return drive(name) if name in DRIVES else load_flight(name).motion


def changed(base: ClassicalSettings, factors: NDArray[np.float64]) -> ClassicalSettings:
    """A classical set with gains and corners times some factors, (15,)."""
    tables = base.model_dump()
    for (table, key), factor in zip(_CORNERS, factors, strict=True):
        entry = tables[table][key]
        entry |= {"value": entry["value"] * float(factor), "status": "derived"}
        entry["source"] = "scripts/cueing.py: least error sensed within the limits"
    return validated(ClassicalSettings, tables, base.name)


def cost(cued: Cue) -> float:
    """Error sensed over its thresholds, root mean square; beyond the limits five times the rest."""
    error = cued.error.error / cued.error.threshold
    beyond = max(0.0, cued.excursion.largest - 1.0)
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1)))) * (1.0 + 5.0 * beyond)


def tuned(evaluations: int) -> ClassicalSettings:
    """The classical washout with the least cost on `TUNED`."""
    base = load_washout("simona")
    assert isinstance(base, ClassicalSettings)
    flights = [manoeuvre(name) for name in TUNED]

    def mean(logs: NDArray[np.float64]) -> float:
        settings = changed(base, np.exp(logs))
        return float(np.mean([cost(cue(flight, settings, rate=40.0)) for flight in flights]))

    options = {"maxfevals": evaluations, "seed": 5, "verbose": -9, "popsize": 12}
    best, _ = cma.fmin2(mean, np.zeros(len(_CORNERS)), 0.4, options)
    return changed(base, np.exp(best))


def families(classical: WashoutSettings) -> Mapping[str, WashoutSettings]:
    """The washouts to compare, by name."""
    base = load_washout("predictive")
    assert isinstance(base, PredictiveSettings)
    ahead = {
        f"predictive {reference}": base.model_copy(
            update={"prediction": base.prediction.model_copy(update={"reference": reference})}
        )
        for reference in ("constant", "guess", "known")
    }
    optimal = load_washout("optimal").with_gains(np.ones(6))
    return {"classical": load_washout("simona"), "tuned": classical, "optimal": optimal, **ahead}


def main() -> None:
    """Compare, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tune", type=int, help="evaluations of the search")
    parser.add_argument("--rate", type=float, default=80.0, help="frames a second")
    parser.add_argument("--out", type=Path, default=Path("out/cueing"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    found = Path(__file__).with_name("cueing_tuned.toml")
    if options.tune is not None:
        found = save_washout(tuned(options.tune), options.out / "tuned.toml")
    rows = []
    for name in (*TUNED, *sorted({*flight_names(), *DRIVES} - {*TUNED})):
        for family, settings in families(load_washout(found)).items():
            cued = cue(manoeuvre(name), settings, rate=options.rate)
            measures = judge(cued)._asdict()
            row = {"manoeuvre": name, "set": "tuned" if name in TUNED else "held out"}
            row |= {"family": family, "largest_share": f"{cued.excursion.largest:.6g}"}
            rows.append(row | {key: f"{value:.6g}" for key, value in measures.items()})
            print(", ".join(rows[-1].values()), flush=True)
    with (options.out / "cueing.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
