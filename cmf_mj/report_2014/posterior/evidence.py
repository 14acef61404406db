"""What the report says of the machine, and how likely a machine makes it.

    hardware rows    -90 deg, -3 dB and damping ratio of Tables 2-4 and 2-6, in heave
    hardware fits    Eqs 4.12, 4.15 and 4.18, leg velocity per command: gain at 1 Hz, gain at 5 Hz
                     over it, phase at 3 Hz, frequency and damping ratio of the leg's pair
    three g          under force feedback, section 3.4.2: what supply pressure the oscillation needs
    flown            the velocity law is stable in all six degrees of freedom with all cabs

With y the value printed and m that of a machine, both as logarithms but for phases and damping
ratios, an observation counts -((m - y) / s)^2 / 2. The report states no errors, so s comes from its
own contradictions. Table 4-1 prints four results of one law on one machine, three by way of linear
models: their scatter is s of a hardware row. Models fitted to the machine miss its -90 deg by 9 %
(root mean square): s of what the three fits say is that, as a share or in radians, and their own
scatter. The oscillation counts with the probability that 10 % of error leaves more than 3 g.
"""

from collections.abc import Iterable, Mapping
from functools import lru_cache
from itertools import product
from typing import Any, NamedTuple

import control
import numpy as np
from numpy.typing import NDArray
from scipy import stats

from cmf_mj.analysis.limit_cycle import limit_cycle
from cmf_mj.analysis.published import published_results
from cmf_mj.control.law import load_law
from cmf_mj.core.units import RATE, STANDARD_GRAVITY
from cmf_mj.facility.unknown import Unknown
from cmf_mj.facility.unknowns import Unknowns
from cmf_mj.plant.parameters import HydraulicParameters, load_hydraulics
from cmf_mj.report_2014.models import HARDWARE_MODELS, hardware_velocity
from cmf_mj.studies.case import make_case
from cmf_mj.studies.fit.evidence import FARTHEST

Array = NDArray[np.float64]

ROWS = (("2-4", "original"), ("2-6", "velocity"))
"""Tables of the hardware rows, and their laws."""

shipped = lru_cache(load_law)
"""Laws by name, each read once."""

HELD_OUT = "velocity_integral"
"""Law of the hardware's result that is predicted and never used."""

FLOWN = "velocity"
"""Law that must be stable with all cabs."""

PRESSURES = (1300.0, 1800.0, 2300.0, 3000.0)
"""Supply pressures that force feedback is simulated at [psi]."""

REPORTED_G, _READING = 3.0, 0.1
"""The oscillation's acceleration [g], and the relative error of reading it off a figure."""

FIELDS = ("phase_bandwidth_hz", "gain_bandwidth_hz", "damping_ratio")
_LINES = np.array([1.0, 3.0, 5.0])
_PAIR_HZ = (4.0, 25.0)
"""Where the leg's pair of poles is looked for."""

_SUPPLY = Unknowns(
    ratio=Unknown(path="hydraulics.supply", low=0.1, high=10.0, unit="1", source="section 3.4.2")
)


class Observation(NamedTuple):
    """One quantity that the report states."""

    name: str
    group: str  #: `rows` or `fits`.
    value: float  #: As printed.
    deviation: float  #: s, of the logarithm where `relative`.
    relative: bool

    def counted(self, value: Any) -> Any:
        """A value as it counts: the logarithm where `relative`."""
        return np.log(value) if self.relative else value


@lru_cache
def scatter() -> Array:
    """Standard deviations of Table 4-1: ln -90 deg, ln -3 dB and damping ratio."""
    table = np.array(
        [[getattr(row, f) for f in FIELDS] for row in published_results() if row.table == "4-1"]
    )
    return np.array([*np.log(table[:, :2]).std(axis=0, ddof=1), table[:, 2].std(ddof=1)])


@lru_cache
def discrepancy() -> float:
    """Root mean square of ln(model / hardware) of -90 deg in Table 4-1."""
    rows = {
        str(row.of): row.phase_bandwidth_hz for row in published_results() if row.table == "4-1"
    }
    machine = rows.pop("hardware")
    return float(np.sqrt(np.mean([np.log(value / machine) ** 2 for value in rows.values()])))  # type: ignore[operator]


def fit_features(velocity: control.StateSpace) -> dict[str, float]:
    """Of a system from a command to a velocity; the pair is the one that shows most in it.

    A machine has pairs of other motions near that of heave, in which a trace of them is felt. That
    of a fit is the one of the largest residue |c r| |l b|.
    """
    response = control.frequency_response(velocity, 2.0 * np.pi * _LINES).frdata[0, 0]
    gain, phase = np.abs(response), np.unwrap(np.angle(response))
    a, b, c = (np.asarray(m) for m in (velocity.A, velocity.B, velocity.C))
    poles, right = np.linalg.eig(a)
    residues = np.abs(c @ right)[0] * np.abs(np.linalg.solve(right, b.astype(complex)))[:, 0]
    size = np.abs(poles) / (2.0 * np.pi)
    inside = (poles.imag > 0.0) & (size > _PAIR_HZ[0]) & (size < _PAIR_HZ[1])
    pair = poles[inside][np.argmax(residues[inside])] if inside.any() else complex(np.nan)
    frequency = float(np.abs(pair)) / (2.0 * np.pi)
    damping = float(-pair.real / np.abs(pair))
    features = gain[0], gain[2] / gain[0], phase[1], frequency, damping
    return dict(zip(_FIT_NAMES, map(float, features), strict=True))


_FIT_NAMES = ("gain_1_hz", "gain_5_over_1_hz", "phase_3_hz", "pair_hz", "pair_damping")


@lru_cache
def observations() -> tuple[Observation, ...]:
    """All numbers that are stated; last the one held out, the damping ratio with the integral."""
    printed = {(row.table, row.law): row for row in published_results() if row.of == "hardware"}
    found = []
    for (table, law), (field, s) in product(ROWS, zip(FIELDS, scatter().tolist(), strict=True)):
        value, log = getattr(printed[table, law], field), field != "damping_ratio"
        found.append(Observation(f"{law}_{field}", "rows", value, s, log))
    fits = [fit_features(control.ss(hardware_velocity(n).to_si())) for n in HARDWARE_MODELS]
    for name in _FIT_NAMES:
        values = np.array([fit[name] for fit in fits])
        relative = name != "phase_3_hz"
        counted = np.log(values) if relative else values
        middle = float(np.exp(counted.mean()) if relative else counted.mean())
        deviation = float(np.hypot(counted.std(ddof=1), discrepancy()))
        found.append(Observation(name, "fits", middle, deviation, relative))
    (value,) = (row.damping_ratio for (_, law), row in printed.items() if law == HELD_OUT)
    assert value is not None
    held = (f"{HELD_OUT}_damping_ratio", "rows", value, float(scatter()[2]), False)
    return (*found, Observation(*held))


@lru_cache
def printed_numbers() -> tuple[Array, Array]:
    """What all observations print, as counted, and their deviations s, (m,)."""
    every = observations()
    y, s = ([one.counted(one.value) for one in every], [one.deviation for one in every])
    return np.array(y), np.array(s)


def counted(rows: Iterable[Mapping[str, float]]) -> Array:
    """What machines make of all observations, as counted, (n, m)."""
    return np.array([[one.counted(row[one.name]) for one in observations()] for row in rows])


def log_likelihoods(made: Array, printed: Array | None = None) -> Array:
    """Of each observation and machine, (n, m); `printed` (m,) stands in for the report's."""
    y, s = printed_numbers()
    off = np.abs((made - (y if printed is None else printed)) / s)
    off[~(off < FARTHEST)] = FARTHEST
    return np.asarray(-0.5 * off**2)


def oscillation_g(
    supply_pressure: float, hydraulics: str | HydraulicParameters = "report"
) -> float:
    """Acceleration under force feedback [g] at a supply pressure [psi]: the report's model.

    Simulated on single legs with a hydraulic set, a step of 1 in in heave.
    """
    parameters = load_hydraulics(hydraulics)
    ratio = supply_pressure / parameters.supply_pressure.value
    changed = _SUPPLY.apply({"ratio": ratio}, parameters)
    case = make_case("force", "heave", "single_legs", hydraulics=changed)
    return limit_cycle(case.run(case.step(), rate=RATE)).acceleration / STANDARD_GRAVITY


def oscillation_likelihood(supply_pressure: Array, simulated: Array) -> Array:
    """Ln P(more than 3 g) at supply pressures [psi]; `simulated` [g] at `PRESSURES`."""
    made = np.interp(supply_pressure, PRESSURES, simulated)
    return np.asarray(stats.norm.logsf(REPORTED_G, made, _READING * made))
