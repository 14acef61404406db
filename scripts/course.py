"""Numbers and time series of the course in docs/tutorials/course.md.

    python scripts/course.py [--out out/course]

The course treats one leg by hand: a mass on its oil spring, an actuator with the lag of its drive,
a law with gains on position and acceleration. `leg` is that closed form; the page with sliders,
docs/_static/course/leg.html, has it in JavaScript. `legs.csv` has its numbers for the leg in heave
and in surge, `step_surge.csv` and `step_heave.csv` what the simulation does, `*-metadata.json`
their columns as CSV on the Web (W3C). `scripts/update_docs.py` takes all of them.
"""

import argparse
import csv
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj import Hexapod, load_hydraulics, load_law, load_scenario
from cmf_mj.core import units
from cmf_mj.core.units import INCH, RATE

EVERY = 16  #: Frames from row to row of the time series: 128 a second.
SECONDS = 4.0  #: Of each time series.
COLUMNS = {
    "time_s": ("time", 0, "s", "Time; the step is demanded at 1 s"),
    "demand_m": ("demand_pose", None, "m", "Pose demanded, along the axis of the file"),
    "response_m": ("platform_pose", None, "m", "Pose of the platform along that axis"),
    "leg_2_m": ("leg_extension", 1, "m", "Extension of leg 2 from neutral, positive out"),
    "leg_2_cap_Pa": ("cap_pressure", 1, "Pa", "Cap pressure of leg 2, gauge; extends the leg"),
    "leg_2_rod_Pa": ("rod_pressure", 1, "Pa", "Rod pressure of leg 2, gauge; retracts the leg"),
    "leg_2_valve": ("valve_command", 1, "1", "Command of leg 2, fraction of full; extends"),
}


class Given(NamedTuple):
    """What the sliders set, beside the mass, and what is fixed."""

    stiffness: float  #: Of the oil of a leg, beta (A_c + A_r) / h [N/m].
    speed: float  #: Of the leg for one per cent of command [in/s/%].
    gain: float  #: Of the law on the position of a leg at rest [%/in].
    acceleration: float  #: Of the law on its acceleration [%/(in/s^2)].
    tau: float  #: Lag of the valve's drive [s].
    rate: float  #: At which leakage lets the load down [1/s].
    load: float  #: Of the law on the force of a leg [%/N m/in].


def one(gain: float | tuple[float, ...]) -> float:
    """A gain that is the same for all legs."""
    return float(np.unique(gain).item())


def given(name: str = "velocity") -> Given:
    """The numbers of the set `hardware` and of a law.

    The law acts on the position by C(z) = D + C B / (z - A); about z = 1, with z = e^(sT), that is
    a gain, a gain on velocity, which the law's own nearly cancels, and one on acceleration,
    C B T^2 (1/q^2 - 1/(2q)) / q with q = 1 - A.
    """
    oil, law = load_hydraulics("hardware"), load_law(name)
    q, both = 1.0 - one(law.state_gain), one(law.output_gain) * one(law.input_gain.position)
    return Given(
        stiffness=oil.bulk_modulus.si * (oil.cap_area + oil.rod_area) / oil.half_stroke.si,
        speed=oil.leg_speed.si / 100.0 / INCH,
        gain=-(both / q + one(law.direct_gain.position)),
        acceleration=-both / q / RATE**2 * (1.0 / q**2 - 0.5 / q),
        tau=1.0 / oil.drive_lag.si,
        rate=oil.leak_rate.si,
        load=-one(law.direct_gain.cap_pressure) / oil.cap_area * INCH,
    )


def polynomial(mass: float, of: Given) -> NDArray[np.float64]:
    """Coefficients of s^4 ... 1: (1 + tau s)(s + rate s^2 / w^2 + s^3 / w^2) + A s^2 + K."""
    squared, added = of.stiffness / mass, of.speed * (of.acceleration + of.load * mass)
    loop = np.polymul([of.tau, 1.0], [1.0 / squared, of.rate / squared, 1.0, 0.0])
    return np.polyadd(loop, [added, 0.0, of.speed * of.gain])


def leg(mass: float, of: Given) -> dict[str, float]:
    """Where a leg of a mass [kg] rings and lags [Hz], its peak [dB], damping ratio, margin [dB].

    The damping ratio is that of the slowest pair of poles.
    """
    a = polynomial(mass, of)
    fourth, third, second, _, last = a
    w = 2.0 * np.pi * 0.1 * 150.0 ** (np.arange(4001) / 4000.0)
    poles = np.roots(a)
    slowest = min(poles, key=lambda pole: (abs(pole.imag) < 1e-6 * abs(pole), abs(pole)))
    lowest = (second - np.sqrt(max(second**2 - 4.0 * fourth * last, 0.0))) / (2.0 * fourth)
    return {
        "ring": np.sqrt(of.stiffness / mass) / (2.0 * np.pi),
        "lag90": np.sqrt(lowest) / (2.0 * np.pi),
        "peak": 20.0 * np.log10(max(1.0, np.abs(last / np.polyval(a, 1j * w)).max())),
        "damping": float(-slowest.real / np.abs(slowest)),
        "margin": 20.0 * np.log10((second * third - fourth) / third**2 / last),
    }


def legs() -> str:
    """Both legs by hand, as CSV."""
    found, of = Hexapod("gfd").hydraulic_modes(), given()
    lines = ["leg,mass [kg],mass [lbm],rings at [Hz],-90 deg [Hz],peak [dB],damping,margin [dB]"]
    for name, mode in (("heave", 3), ("surge", 0)):
        mass = float(found.leg_mass[mode])
        one = leg(mass, of)
        cells = f"{mass:.0f},{units.from_si('lbm', mass):.0f},{one['ring']:.2f},{one['lag90']:.2f}"
        lines.append(f"{name},{cells},{one['peak']:.1f},{one['damping']:.2f},{one['margin']:.1f}")
    return "\n".join(lines) + "\n"


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
    columns = [
        {"name": key, "datatype": "number", "dc:description": said, "schema:unitText": unit}
        for key, (_, _, unit, said) in COLUMNS.items()
    ]
    table = {
        "@context": "http://www.w3.org/ns/csvw",
        "url": path.name,
        "dc:title": f"Step of 1 in along {name}, GFD, velocity law, {RATE // EVERY} Hz",
        "dc:description": f"cmf run {name}_ring with the velocity law; made by scripts/course.py",
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
    (folder / "legs.csv").write_text(legs(), encoding="utf-8")
    for axis, name in ((0, "surge"), (2, "heave")):
        save_step(axis, name, folder)
    print(f"written to {folder}: legs.csv, step_surge.csv, step_heave.csv, their dictionaries")


if __name__ == "__main__":
    main()
