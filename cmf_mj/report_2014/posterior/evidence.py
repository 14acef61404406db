"""What the report says of the machine, and how likely a machine makes it.

    hardware rows    -90 deg, -3 dB and damping ratio of Tables 2-4 and 2-6, in heave
    hardware fits    Eqs 4.12, 4.15 and 4.18, leg velocity per command: gain at 1 Hz, gain at 5 Hz
                     over it, phase at 3 Hz, frequency and damping ratio of the leg's pair
    three g          under force feedback, section 3.4.2: what supply pressure the oscillation needs
    flown            the velocity law is stable in all six degrees of freedom with all cabs

Observations are compared transformed: the phase of the fits and the damping ratios of hardware rows
as they are, all others by their logarithms. With y the printed value and m that of a machine, both
transformed, ln L of an observation is -((m - y) / s)^2 / 2. The report states no errors, so s comes
from its own contradictions. Table 4-1 prints four results of one law on one machine, three by way
of linear models: their scatter is s of a hardware row. Models fitted to the machine miss its
-90 deg by 9 % (root mean square): s of a mean of the three fits is that, as a share or in radians,
and their own scatter. L of the oscillation is the probability that 10 % of error leaves over 3 g.
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

HELD_OUT_LAW = "velocity_integral"
"""Law of the hardware row whose damping ratio is predicted and weighs no machine."""

PRESSURES = (1300.0, 1800.0, 2300.0, 3000.0)
"""Supply pressures that force feedback is simulated at [psi]."""

REPORTED_G = 3.0  #: Acceleration of the oscillation [g].
_READING_ERROR = 0.1  #: Relative error of reading it off a figure.

ROW_FIELDS = ("phase_bandwidth_hz", "gain_bandwidth_hz", "damping_ratio")
"""Fields of a hardware row, as measures and published results name them."""

_ABSOLUTE = ("damping_ratio", "phase_3_hz")
"""Fields of hardware rows and features of fits that are compared as they are."""

_FIT_FREQUENCIES = np.array([1.0, 3.0, 5.0])  #: Where responses of fits are read [Hz].
_LOWEST_PAIR, _HIGHEST_PAIR = 4.0, 25.0  #: Bounds of the leg's pair of poles [Hz].

_SUPPLY = Unknowns(
    ratio=Unknown(path="hydraulics.supply", low=0.1, high=10.0, unit="1", source="section 3.4.2")
)


class Observation(NamedTuple):
    """One number that the report prints, or the mean of one over its fits."""

    name: str
    group: str  #: `rows` or `fits`.
    value: float  #: As printed.
    deviation: float  #: s, of the logarithm where `is_relative`.
    is_relative: bool
    is_held_out: bool = False  #: Whether it is predicted and weighs no machine.

    def transformed(self, value: Any) -> Any:
        """A value as it is compared: the logarithm where `is_relative`."""
        return np.log(value) if self.is_relative else value


def _is_relative(quantity: str) -> bool:
    """Whether a field of a hardware row or a feature of a fit is compared by its logarithm."""
    return quantity not in _ABSOLUTE


@lru_cache
def scatter() -> dict[str, float]:
    """Standard deviations of Table 4-1 by field, of bandwidths those of the logarithms."""
    deviations = {}
    for field in ROW_FIELDS:
        printed = np.array([getattr(row, field) for row in printed_table_4_1().values()])
        values = np.log(printed) if _is_relative(field) else printed
        deviations[field] = float(values.std(ddof=1))
    return deviations


@lru_cache
def discrepancy() -> float:
    """Root mean square of ln(model / hardware) of -90 deg in Table 4-1."""
    bandwidths = {of: row.phase_bandwidth_hz for of, row in printed_table_4_1().items()}
    hardware = bandwidths.pop("hardware")
    return float(np.sqrt(np.mean([np.log(hz / hardware) ** 2 for hz in bandwidths.values()])))  # type: ignore[operator]


def fit_features(velocity: control.StateSpace) -> dict[str, float]:
    """Features by name of a system from command to leg velocity, such as the hardware fits.

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
    is_candidate = (poles.imag > 0.0) & (hertz > _LOWEST_PAIR) & (hertz < _HIGHEST_PAIR)
    pair = complex(np.nan)
    if is_candidate.any():
        pair = poles[is_candidate][np.argmax(residues[is_candidate])]
    return {
        "gain_1_hz": gain_1_hz,
        "gain_5_over_1_hz": gain_5_hz / gain_1_hz,
        "phase_3_hz": phase_3_hz,
        "pair_hz": float(np.abs(pair)) / (2.0 * np.pi),
        "pair_damping": float(-pair.real / np.abs(pair)),
    }


def _row_observation(law: str, field: str, row: Published) -> Observation:
    """A field of a hardware row."""
    return Observation(
        name=f"{law}_{field}",
        group="rows",
        value=getattr(row, field),
        deviation=scatter()[field],
        is_relative=_is_relative(field),
        is_held_out=law == HELD_OUT_LAW,
    )


def _fit_observations() -> list[Observation]:
    """Means of the features of the three fits, geometric where they are relative."""
    fits = [fit_features(control.ss(hardware_velocity(n).to_si())) for n in HARDWARE_MODELS]
    means = []
    for name in fits[0]:
        features, is_relative = np.array([fit[name] for fit in fits]), _is_relative(name)
        values = np.log(features) if is_relative else features
        mean = float(np.exp(values.mean()) if is_relative else values.mean())
        deviation = float(np.hypot(values.std(ddof=1), discrepancy()))
        means.append(Observation(name, "fits", mean, deviation, is_relative))
    return means


@lru_cache
def observations() -> tuple[Observation, ...]:
    """All observations; last the one held out, the damping ratio with the integral."""
    rows = {(row.table, row.law): row for row in published_results() if row.of == "hardware"}
    row_observations = [
        _row_observation(law, field, rows[table, law])
        for (law, table), field in product(ROW_TABLES.items(), ROW_FIELDS)
    ]
    (held_out_row,) = (row for row in rows.values() if row.law == HELD_OUT_LAW)
    held_out = _row_observation(HELD_OUT_LAW, "damping_ratio", held_out_row)
    return *row_observations, *_fit_observations(), held_out


class ObservationArrays(NamedTuple):
    """All observations as arrays."""

    values: Array  #: y, transformed, (m,).
    deviations: Array  #: s, (m,).
    is_used: NDArray[np.bool_]  #: Whether it weighs machines, (m,).


@lru_cache
def observation_arrays() -> ObservationArrays:
    """Values, deviations and use of all observations."""
    return ObservationArrays(
        values=np.array([item.transformed(item.value) for item in observations()]),
        deviations=np.array([item.deviation for item in observations()]),
        is_used=np.array([not item.is_held_out for item in observations()]),
    )


def transformed_predictions(rows: Iterable[Mapping[str, float]]) -> Array:
    """What machines make of all observations, transformed, (n, m); a row a machine."""
    return np.array([[item.transformed(row[item.name]) for item in observations()] for row in rows])


def log_likelihoods(predicted: Array, printed: Array | None = None) -> Array:
    """Ln L of each observation and machine, (n, m), of predictions (n, m), all transformed.

    `printed` (m,) stands in for the report's values.
    """
    report = observation_arrays()
    values = report.values if printed is None else printed
    distance = np.abs((predicted - values) / report.deviations)
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


def oscillation_log_likelihood(supply_pressure: Array, simulated: Array) -> Array:
    """Ln P(more than 3 g) at supply pressures [psi]; `simulated` [g] at `PRESSURES`."""
    acceleration = np.interp(supply_pressure, PRESSURES, simulated)
    return np.asarray(stats.norm.logsf(REPORTED_G, acceleration, _READING_ERROR * acceleration))
