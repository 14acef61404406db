"""The hydraulic crane of Rahikainen et al. (2020), as Project Chrono's demonstration has it.

python examples/crane.py          run its 20 s of commands and print the pressures
python examples/crane.py --step 8 with so many mechanical steps to a frame of 1/2048 s

The benchmark: J. Rahikainen, F. Gonzalez, M. A. Naya, J. Sopanen, A. Mikkola, *On the cosimulation
of multibody systems and hydraulic dynamics*, Multibody System Dynamics 50 (2020), open access, (c)
the authors. Its numbers are read from `demo_MBS_hydraulic_crane.cpp`, `ChHydraulicActuator.cpp` and
`ChHydraulicCircuit.cpp` of Project Chrono (three-clause BSD); rotational inertias are Chrono's
default of 1 kg m^2. What the benchmark does not have is set so that it has no effect.

A crane of mass M and length L at 30 deg carries a ball of mass m. Its cylinder, from a point as far
from the hinge to the crane's middle, closes a triangle of equal sides, so that at rest

    F = (M + 2 m) g = 6860 N,    p_cap = (F + A_rod p_rod) / A_cap = 4.163 MPa
"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np
from numpy.typing import NDArray

import cmf_mj
from cmf_mj.core.units import FRAME

BORE, ROD, CHAMBER = 0.08, 0.035, 0.221  # diameters, both chambers at the start [m]
PUMP, TANK, ROD_START = 76.0, 1.0, 34.61  # [bar]
OIL, HOSE, BARREL = 15000.0, 1500.0, 315000.0  # bulk moduli [bar]
CAP_HOSE, ROD_HOSE = 3.14e-5, 7.85e-5  # [m^3]
NOMINAL = 24e-3 / 60.0 / np.sqrt(35e5)  # all ports [m^3/s/sqrt(Pa)]
THIRD, BORED = 4.71e-5, 0.8 * np.pi / 4.0 * 0.006**2 * np.sqrt(2.0 / 850.0)  # of the throttle
TIMES, COMMANDS = (0.0, 0.5, 2.0, 7.0, 9.0, 10.0), (0.0, 0.0, 0.6, 0.6, -1.0, 0.0)
SECONDS = 20.0

MODEL = f"""
<mujoco model="crane">
  <compiler angle="radian"/>
  <option gravity="0 0 -9.8"/>
  <worldbody>
    <site name="foot" pos="{np.sqrt(0.75)} 0 0"/>
    <body name="crane" euler="0 {-np.pi / 6.0} 0">
      <joint name="hinge" axis="0 -1 0"/>
      <inertial pos="0.5 0 0" mass="500" diaginertia="1 1 1"/>
      <geom type="capsule" fromto="0 0 0 1 0 0" size="0.015" contype="0" conaffinity="0"/>
      <site name="eye" pos="0.5 0 0"/>
      <body name="ball" pos="1 0 0" euler="0 {np.pi / 6.0} 0">
        <joint name="swing" type="ball"/>
        <inertial pos="0 0 -0.3" mass="100" diaginertia="1 1 1"/>
        <geom type="sphere" size="0.04" pos="0 0 -0.3" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <tendon>
    <spatial name="cylinder" springlength="{0.287} {0.713}" stiffness="1e7">
      <site site="foot"/>
      <site site="eye"/>
    </spatial>
  </tendon>
</mujoco>
"""
"""The end stops are springs over the last 8 mm of the chambers."""


_YIELDING = (1.0 / OIL + 1.0 / HOSE) / (1.0 / OIL + 1.0 / BARREL)  # hoses over the cylinder's oil
THROTTLED = {
    "cap_throttle": (np.sqrt(2e5) / BORED, "Pa s/m^3"),
    "cap_dead_volume": ((CAP_HOSE + THIRD) * _YIELDING, "m^3"),
}
"""What the paper's throttle changes: below 2 bar it is linear, and so it is in the whole run."""


def hydraulics(**changes: tuple[float, str]) -> str:
    """The benchmark's numbers as a parameter file; `changes` give others, with their units."""
    cap, oil = 0.25 * np.pi * BORE**2, 1.0 / (1.0 / OIL + 1.0 / BARREL)
    numbers = {
        "bore_diameter": (BORE, "m"),
        "rod_diameter": (ROD, "m"),
        "half_stroke": (CHAMBER, "m"),
        "minimum_gap": (0.1, "mm"),
        "valves": (1.0, "1"),
        "rod_port": (1.0 / (1.0 - (ROD / BORE) ** 2), "1"),
        "leg_speed": (NOMINAL * np.sqrt(0.5e5 * (PUMP - TANK)) / cap / 100.0, "m/s/%"),
        "valve_lag": (35.0, "Hz"),
        "drive_lag": (1e6, "Hz"),
        "threshold_pressure": (0.0, "bar"),
        "transition_pressure": (1e-6, "bar"),
        "supply_pressure": (PUMP, "bar"),
        "return_pressure": (TANK, "bar"),
        "precharge_pressure": (0.5 * PUMP, "bar"),
        "relief_pressure": (2.0 * PUMP, "bar"),
        "proof_pressure": (10.0 * PUMP, "bar"),
        "rest_pressure": (ROD_START, "bar"),
        "bulk_modulus": (oil, "bar"),
        "cap_dead_volume": (CAP_HOSE * _YIELDING, "m^3"),
        "rod_dead_volume": (ROD_HOSE * _YIELDING, "m^3"),
        "viscous_friction": (1e5, "N s/m"),
        "leak_rate": (0.0, "1/s"),
    } | changes
    said = 'status = "published", source = "Rahikainen et al. 2020, Project Chrono"'
    rows = [
        f'{name} = {{ value = {float(n)!r}, unit = "{u}", {said} }}'
        for name, (n, u) in numbers.items()
    ]
    return "\n".join(['base = "hardware"', "[crane]", 'supply = "constant"', *rows])


def crane(steps: int = 1, **changes: tuple[float, str]) -> cmf_mj.Plant:
    """The crane with its cylinder, in so many mechanical steps to a frame."""
    with TemporaryDirectory() as folder:
        oil = Path(folder) / "oil.toml"
        oil.write_text(hydraulics(**changes))
        spec = mujoco.MjSpec.from_string(MODEL)
        retracted = {"cylinder": 0.5 - CHAMBER}
        return cmf_mj.attach_hydraulics(spec, retracted, oil, timestep=FRAME / steps)


def commanded(time: NDArray[np.float64]) -> NDArray[np.float64]:
    """The benchmark's command to the valve, fractions, at times [s]."""
    return np.interp(time % TIMES[-1], TIMES, COMMANDS)


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--step", type=int, default=1, help="mechanical steps to a frame")
    options = parser.parse_args()
    plant = crane(options.step)
    middles = np.arange(0.5 * FRAME, SECONDS, FRAME)
    record = cmf_mj.drive(plant, commanded(middles)[:, None], record_every=512)
    print(f"{'time':>6} {'length':>8} {'cap':>7} {'rod':>7} {'force':>8}")
    print(f"{'s':>6} {'m':>8} {'bar':>7} {'bar':>7} {'N':>8}")
    for row, time in enumerate(record.time):
        length = record["leg_extension"][row, 0] + plant.neutral[0]
        cap, rod = (1e-5 * record[f"{side}_pressure"][row, 0] for side in ("cap", "rod"))
        print(f"{time:6.2f} {length:8.4f} {cap:7.2f} {rod:7.2f} {record['leg_force'][row, 0]:8.0f}")


if __name__ == "__main__":
    main()
