"""Files to begin from: what ships, and one small file of every format, good and damaged."""

from pathlib import Path

import numpy as np
from fuzzing import damaged

from cmf_mj.control.dcu.play import Arrivals
from cmf_mj.facility.host.stream import make_stream, write_arrivals, write_stream
from cmf_mj.pilot.flight import Flight, load_flight
from cmf_mj.pilot.motion import PilotMotion
from cmf_mj.record.columns import write_facility_csv
from cmf_mj.record.record import Record

CAMPAIGN = """
[recordings.sine]
file = "facility.csv"
kind = "multisine"

[unknowns.mass]
path = "cab.mass"
deviation = 30.0
source = "a guess"
"""


def small_record() -> Record:
    """A record with the channels that recordings need, 2 s at 128 Hz."""
    time = np.arange(256) / 128.0
    wave = 0.01 * np.sin(2.0 * np.pi * np.outer(time, [0.5, 1.0, 1.5, 2.0, 2.5, 3.0]))
    names = {"leg_position": "m", "leg_reference": "m", "leg_velocity": "m/s"}
    names |= {"valve_command": "1", "leg_acceleration": "m/s^2", "compensator_output": "1"}
    command = {"kind": "sine", "axis": "heave", "amplitude": 0.01, "frequency": 0.5}
    metadata = {"sample_rate": 128.0, "law": "velocity", "plant": "hexapod", "command": command}
    return Record(time, dict.fromkeys(names, wave), names, metadata)


def small_flight() -> Flight:
    """The first second of a shipped flight."""
    flight = load_flight("gusts")
    motion = flight.motion
    parts = (motion.specific_force, motion.angular_rate, motion.attitude)
    return Flight(PilotMotion(motion.time[:80], *(part[:80] for part in parts)), flight.origin)


def make_files(folder: Path, generator: np.random.Generator) -> list[str]:
    """Small files of every format in a folder, and one damaged copy of each; their names."""
    time = np.arange(80) / 40.0
    stream = make_stream(time, 0.01 * np.sin(np.outer(time, np.ones(6))))
    number = np.arange(80)
    small_record().save(folder / "run.parquet")
    write_facility_csv(small_record(), folder / "facility.csv")
    write_stream(stream, folder / "stream.csv")
    write_stream(stream, folder / "stream.parquet")
    write_arrivals(Arrivals(26 * number, number, time, stream.values), folder / "host.parquet")
    small_flight().save(folder / "flight.csv")
    small_flight().save(folder / "flight.parquet")
    small_flight().motion.save(folder / "motion.csv")
    law = '[mine]\nbased_on = "velocity"\ntitle = "$\\\\foo$"\n'
    (folder / "law.toml").write_text(law)
    (folder / "cab.toml").write_text('base = "gfd"\n[mine]\n')
    (folder / "oil.toml").write_text('base = "hardware"\n[mine]\n')
    (folder / "scenario.toml").write_text('title = "$\\\\foo$"\nduration = 0.1\n')
    (folder / "campaign.toml").write_text(CAMPAIGN)
    (folder / "huge.toml").write_text("duration = 1e9\n")
    (folder / "deep.toml").write_text("x = " + "[" * 3000)
    gap = "time,surge,sway,heave,roll,pitch,yaw\n"
    gap += "".join(f"{at},0,0,0,0,0,0\n" for at in (0.0, 0.1, 1e9))
    (folder / "gap.csv").write_text(gap)
    (folder / "dates.csv").write_text(gap.replace("1000000000.0", "2020-01-01"))
    names = sorted(path.name for path in folder.iterdir())
    for name in names:
        content = damaged((folder / name).read_bytes(), generator)
        (folder / f"bad_{name}").write_bytes(content)
    return [*names, *(f"bad_{name}" for name in names)]
