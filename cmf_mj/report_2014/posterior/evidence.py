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
from cmf_mj.analysis.published import Published, published_results
from cmf_mj.control.law import load_law
from cmf_mj.core.units import RATE, STANDARD_GRAVITY
from cmf_mj.facility.unknown import Unknown
from cmf_mj.facility.unknowns import Unknowns
from cmf_mj.plant.parameters import HydraulicParameters, load_hydraulics
from cmf_mj.report_2014.models import HARDWARE_MODELS, hardware_velocity, printed_table_4_1
from cmf_mj.studies.case import make_case
from cmf_mj.studies.fit.evidence import FARTHEST

Array = NDArray[np.float64]

ROW_TABLES = {"original": "2-4", "velocity": "2-6"}
"""Tables of the hardware rows by their law."""

shipped_law = lru_cache(load_law)
"""Laws by name, each read once."""

HELD_OUT = "velocity_integral"
"""Law of the hardware's result that is predicted and never used."""

FLOWN = "velocity"
"""Law that must be stable with all cabs."""

PRESSURES = (1300.0, 1800.0, 2300.0, 3000.0)
"""Supply pressures that force feedback is simulated at [psi]."""

REPORTED_G = 3.0  #: Acceleration of the oscillation [g].
_READING_ERROR = 0.1  #: Relative error of reading it off a figure.

ROW_FIELDS = ("phase_bandwidth_hz", "gain_bandwidth_hz", "damping_ratio")
"""Fields of a hardware row, as measures and published results name them."""

_FIT_FREQUENCIES = np.array([1.0, 3.0, 5.0])  #: Where responses of fits are read [Hz].
_LOWEST_PAIR, _HIGHEST_PAIR = 4.0, 25.0  #: Bounds of the leg's pair of poles [Hz].

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


USED = slice(None, -1)
"""Observations that weigh machines: all but the last, which is held out."""


@lru_cache
def scatter() -> dict[str, float]:
    """Standard deviations of Table 4-1 by field, of bandwidths those of the logarithms."""
    deviations = {}
    for field in ROW_FIELDS:
        printed = np.array([getattr(row, field) for row in printed_table_4_1().values()])
        values = printed if field == "damping_ratio" else np.log(printed)
        deviations[field] = float(values.std(ddof=1))
    return deviations


@lru_cache
def discrepancy() -> float:
    """Root mean square of ln(model / hardware) of -90 deg in Table 4-1."""
    models = {of: row.phase_bandwidth_hz for of, row in printed_table_4_1().items()}
    hardware = models.pop("hardware")
    return float(np.sqrt(np.mean([np.log(hz / hardware) ** 2 for hz in models.values()])))  # type: ignore[operator]


def fit_features(velocity: control.StateSpace) -> dict[str, float]:
    """Features by name of a system from a command to a velocity, as of the hardware fits.

    A machine has pairs of poles of other motions near that of heave, and a trace of them is felt
    in heave. The pair of a fit is the one of the largest residue |c r| |l b|.
    """
    response = control.frequency_response(velocity, 2.0 * np.pi * _FIT_FREQUENCIES).frdata[0, 0]
    gain_1_hz, _, gain_5_hz = np.abs(response).tolist()
    _, phase_3_hz, _ = np.unwrap(np.angle(response)).tolist()
    a, b, c = (np.asarray(matrix) for matrix in (velocity.A, velocity.B, velocity.C))
    poles, right = np.linalg.eig(a)
    residues = np.abs(c @ right)[0] * np.abs(np.linalg.solve(right, b.astype(complex)))[:, 0]
    hertz = np.abs(poles) / (2.0 * np.pi)
    candidate = (poles.imag > 0.0) & (hertz > _LOWEST_PAIR) & (hertz < _HIGHEST_PAIR)
    pair = complex(np.nan)
    if candidate.any():
        pair = poles[candidate][np.argmax(residues[candidate])]
    return {
        "gain_1_hz": gain_1_hz,
        "gain_5_over_1_hz": gain_5_hz / gain_1_hz,
        "phase_3_hz": phase_3_hz,
        "pair_hz": float(np.abs(pair)) / (2.0 * np.pi),
        "pair_damping": float(-pair.real / np.abs(pair)),
    }


def _row_observation(law: str, field: str, printed: Published) -> Observation:
    """A number of a hardware row."""
    name, relative = f"{law}_{field}", field != "damping_ratio"
    return Observation(name, "rows", getattr(printed, field), scatter()[field], relative)


def _fit_observations() -> list[Observation]:
    """Means of the three fits."""
    fits = [fit_features(control.ss(hardware_velocity(n).to_si())) for n in HARDWARE_MODELS]
    means = []
    for name in fits[0]:
        values = np.array([fit[name] for fit in fits])
        relative = name != "phase_3_hz"
        counted = np.log(values) if relative else values
        mean = float(np.exp(counted.mean()) if relative else counted.mean())
        deviation = float(np.hypot(counted.std(ddof=1), discrepancy()))
        means.append(Observation(name, "fits", mean, deviation, relative))
    return means


@lru_cache
def observations() -> tuple[Observation, ...]:
    """All numbers that are stated; last the one held out, the damping ratio with the integral."""
    printed = {(row.table, row.law): row for row in published_results() if row.of == "hardware"}
    rows = [
        _row_observation(law, field, printed[table, law])
        for (law, table), field in product(ROW_TABLES.items(), ROW_FIELDS)
    ]
    (held_out,) = (row for row in printed.values() if row.law == HELD_OUT)
    return *rows, *_fit_observations(), _row_observation(HELD_OUT, "damping_ratio", held_out)


class PrintedNumbers(NamedTuple):
    """All observations as arrays."""

    values: Array  #: y, as counted, (m,).
    deviations: Array  #: s, (m,).


@lru_cache
def printed_numbers() -> PrintedNumbers:
    """Values and deviations of all observations."""
    stated = observations()
    values = np.array([observation.counted(observation.value) for observation in stated])
    return PrintedNumbers(values, np.array([observation.deviation for observation in stated]))


def counted(rows: Iterable[Mapping[str, float]]) -> Array:
    """What machines make of all observations, as counted, (n, m)."""
    stated = observations()
    return np.array([[number.counted(row[number.name]) for number in stated] for row in rows])


def log_likelihoods(predicted: Array, printed: Array | None = None) -> Array:
    """Ln L of each observation and machine, (n, m); `printed` (m,) stands in for the report's."""
    values, deviations = printed_numbers()
    distance = np.abs((predicted - (values if printed is None else printed)) / deviations)
    distance[~(distance < FARTHEST)] = FARTHEST
    return np.asarray(-0.5 * distance**2)


def oscillation_g(
    supply_pressure: float, hydraulics: str | HydraulicParameters = "report"
) -> float:
    """Acceleration under force feedback [g] at a supply pressure [psi]: the report's model.

    Simulated on single legs with a hydraulic set, a step of 1 in in heave.
    """
    nominal = load_hydraulics(hydraulics)
    ratio = supply_pressure / nominal.supply_pressure.value
    parameters = _SUPPLY.apply({"ratio": ratio}, nominal)
    case = make_case("force", "heave", "single_legs", hydraulics=parameters)
    return limit_cycle(case.run(case.step(), rate=RATE)).acceleration / STANDARD_GRAVITY


def oscillation_likelihood(supply_pressure: Array, simulated: Array) -> Array:
    """Ln P(more than 3 g) at supply pressures [psi]; `simulated` [g] at `PRESSURES`."""
    acceleration = np.interp(supply_pressure, PRESSURES, simulated)
    return np.asarray(stats.norm.logsf(REPORTED_G, acceleration, _READING_ERROR * acceleration))
