"""Laws behind the host: errors of flights, limit cycles of wild hosts.

Of the shipped flights, flown as `cmf fly` does, it tells the sensed error of the machine in
specific force: root mean square over the flight, three axes together [mm/s^2].
Then random host streams jump and sweep to 6 Hz and hold still, through DCU and limits with all
cabs, half of them with valves 10 % off: a valve command that still swings by more than 0.3 in the
last second is a limit cycle. Writes `flights.md` and prints it.
"""

import argparse
from pathlib import Path

import numpy as np

from cmf_mj import Hexapod, Law, load_hydraulics, load_law
from cmf_mj.core.result import Table
from cmf_mj.facility.host.stream import HostStream, make_stream
from cmf_mj.facility.operation import operate
from cmf_mj.facility.unknowns import with_valve_gains
from cmf_mj.machine.models import CABS
from cmf_mj.pilot.cueing import within_limits
from cmf_mj.pilot.flight import flight_names, load_flight
from cmf_mj.pilot.fly import fly
from cmf_mj.pilot.motion import MOST_RATE

SIZES = np.array([1.2, 1.2, 0.9, 0.45, 0.4, 0.6])
"""Largest amplitude of a stream [m, rad]."""

MOVING, STILL = 6.0, 4.0
"""Parts of a stream [s]."""


def wild_stream(number: int) -> HostStream:
    """Sums of random sines with three jumps, then rest: at neutral, or where it happens to be."""
    generator = np.random.default_rng([77, number])
    time = np.arange(round(MOST_RATE * (MOVING + STILL))) / MOST_RATE
    ends = round(MOVING * MOST_RATE)
    size = SIZES * 10.0 ** generator.uniform(-1.0, 0.0)
    pose = np.empty((time.size, 6))
    for dof in range(6):
        frequency = 10.0 ** generator.uniform(np.log10(0.2), np.log10(6.0), 6)
        phase, weight = generator.uniform(0.0, 2.0 * np.pi, 6), generator.uniform(0.0, 1.0, 6)
        wave = np.sin(2.0 * np.pi * np.outer(time, frequency) + phase) @ weight
        pose[:, dof] = size[dof] * wave / np.abs(wave).max()
    for at in generator.integers(round(MOST_RATE), ends, 3):
        pose[at:] += generator.uniform(-0.3, 0.3, 6) * size
    pose *= np.clip(np.minimum(time, (MOVING - time) / 0.05), 0.0, 1.0)[:, None]
    if number % 2:
        pose[ends:] = pose[ends - 6]
    return within_limits(make_stream(time, pose))[0]


def cycles(law: Law, number: int) -> bool:
    """Whether a wild stream leaves the machine in a limit cycle."""
    hydraulics = with_valve_gains(load_hydraulics("hardware"), number if number % 4 > 1 else None)
    plant, stream = Hexapod(CABS[number % len(CABS)], hydraulics), wild_stream(number)
    run = operate(plant, law, stream, electronics=None, protection=None, record_every=8)
    tail = run.record["valve_command"][-256:]
    return bool(np.ptp(tail, axis=0).max() > 0.3)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of the command line."""
    parser.add_argument("--laws", default="velocity,model_following,modal_plan")
    parser.add_argument("--flights", default=",".join(flight_names()))
    parser.add_argument("--streams", type=int, default=36, help="wild streams")
    parser.add_argument("--out", type=Path, default=Path("out/flights"))


def run(options: argparse.Namespace) -> None:
    """Fly all laws."""
    flights = [name for name in options.flights.split(",") if name]
    header = ["law", *flights, "limit cycles"]
    lines = []
    for chosen in options.laws.split(","):
        law, line = load_law(chosen), [chosen]
        for name in flights:
            ride = fly(load_flight(name).motion, law)
            size = 1e3 * np.linalg.norm(ride.machine.rms[:3])
            line.append(f"{size:.0f}" + (f", {ride.fault}" if ride.fault else ""))
        found = sum(cycles(law, number) for number in range(options.streams))
        lines.append([*line, f"{found} of {options.streams}"])
    table = Table("", header, lines)
    table.save(options.out / "flights.md")
    print(table.markdown())
