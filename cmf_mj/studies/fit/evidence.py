"""What is known of a machine beside recordings: results that somebody states, responses, flights.

    [evidence.velocity]
    source = "Table 2-6"
    law = "velocity"                     # the law it ran, default the campaign's
    dof = "heave"
    phase_bandwidth_hz = 2.94            # likewise gain_bandwidth_hz, peak_gain_db, damping_ratio
    held_back = ["phase_bandwidth_hz"]   # of it, what the fit must predict unseen
    response = [[1.0, -0.1, -25.0]]      # [Hz, dB, deg], a row a frequency
    deviations = { phase_deg = 3.0 }     # where they are not those of the campaign

    [evidence.flown]
    source = "flown with three cabs"
    law = "velocity"
    cabs = ["gfd", "rfd", "ifd"]
    least_damping = 0.03                 # in every mode below 30 Hz

With y what is stated, s its deviation and m that of the linear loop, friction left out, what is
stated counts e^2 / 2 in -ln L,

    e = (y - m - d) / s       of frequencies (ln y - ln(m + d)) / s,  d = m_simulated(x0) - m(x0)
    e = max(0, y - m) / s     of a damping ratio that is a least one

d is what linearisation misses on the data sheet's machine x0, where a campaign asks for it by
`simulated = true`: chirp and step of `cmf compare`, in 30 s.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cmf_mj.analysis.frequency_response import Bandwidths, bandwidths
from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.analysis.linear.loop import loop_response
from cmf_mj.analysis.linear.poles import are_stable, least_damped_mode
from cmf_mj.analysis.measures import Measures, measure_loop, measures_from
from cmf_mj.analysis.modes import bound
from cmf_mj.control.law import Law, load_law
from cmf_mj.core.errors import InputError, within
from cmf_mj.core.settings import Settings, beside
from cmf_mj.core.threads import on_threads
from cmf_mj.facility.unknowns import Unknowns, Values
from cmf_mj.machine.cab import load_cab
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.plant import Plant
from cmf_mj.signals.signal import Dof
from cmf_mj.studies.case import make_case, run_case

Array = NDArray[np.float64]

MEASURES = {
    "phase_bandwidth_hz": "-90 deg [Hz]",
    "gain_bandwidth_hz": "-3 dB [Hz]",
    "peak_gain_db": "peak [dB]",
    "damping_ratio": "zeta",
}
"""What may be stated of a law along an axis, fields of `Measures`, and its title."""

_RESPONSE_MEASURES = ("phase_bandwidth_hz", "gain_bandwidth_hz", "peak_gain_db")
LEAST_DAMPING = "least_damping"  #: What may be stated of all modes.

LINES = np.geomspace(0.4, 15.0, 150)  #: Lines the bandwidths are read between [Hz], 2.5 % apart.
_STEP = 1.5  #: Length of linear steps [s]: the overshoot comes within the first half second.
_FASTEST_HZ = 30.0  #: Modes above it are of valves and sensors, not of the machine [Hz].
FARTHEST = 8.0  #: Deviations of what a machine does not have at all, such as an overshoot.

Positive = Annotated[float, Field(gt=0.0)]
ResponseRow = Annotated[tuple[Positive, float, float], Field(strict=False)]


class Deviations(Settings):
    """How far what is stated may be off: one standard deviation."""

    phase_bandwidth_hz: Positive = 0.1  #: Of its logarithm: a share.
    gain_bandwidth_hz: Positive = 0.1  #: Of its logarithm.
    peak_gain_db: Positive = 1.0  #: [dB].
    damping_ratio: Positive = 0.1
    least_damping: Positive = 0.01  #: Of a shortfall.
    gain_db: Positive = 0.5  #: Of a response [dB].
    phase_deg: Positive = 5.0  #: Of a response [deg].


class EvidenceSettings(Settings):
    """One piece of evidence."""

    source: Annotated[str, Field(min_length=1)]  #: Who states it, where.
    law: str | None = None
    dof: Dof = "heave"
    cabs: Annotated[tuple[str, ...], Field(strict=False)] = ()  #: Default the campaign's.
    phase_bandwidth_hz: Positive | None = None
    gain_bandwidth_hz: Positive | None = None
    peak_gain_db: float | None = None
    damping_ratio: Annotated[float, Field(gt=0.0, lt=1.0)] | None = None
    least_damping: Annotated[float, Field(gt=0.0, lt=1.0)] | None = None
    response: Annotated[tuple[ResponseRow, ...], Field(strict=False)] = ()
    held_back: Annotated[tuple[str, ...], Field(strict=False)] = ()
    deviations: Deviations | None = None


class Statement(NamedTuple):
    """One number that is stated."""

    evidence: str  #: Its name in the campaign.
    quantity: str  #: Its title.
    field: str  #: Of `Deviations`.
    law: str
    dof: str
    cab: str  #: Empty for the campaign's.
    frequency: float  #: Of a response [Hz].
    value: float
    deviation: float
    held_back: bool

    def excess(self, predicted: float) -> float:
        """The error e of a machine; `FARTHEST` where it has no such number."""
        if self.field == LEAST_DAMPING:
            error = float(np.maximum(0.0, self.value - predicted))
        elif self.field.endswith("_hz"):
            error = float(np.log(self.value / predicted)) if 0.0 < predicted < np.inf else np.nan
        else:
            error = self.value - predicted
        if self.field == "phase_deg" and abs(error) > 180.0:
            error = (error + 180.0) % 360.0 - 180.0
        return error / self.deviation if np.isfinite(error) else FARTHEST


class LoopNumbers(NamedTuple):
    """The numbers of a machine that are stated."""

    value: Array  #: (n,), NaN where it has no such number.
    stable: NDArray[np.bool_]  #: Of the loop behind each, (n,).


class Evidence(NamedTuple):
    """All that is stated of a machine, with the laws it ran and the machine of the data sheet."""

    statements: tuple[Statement, ...]
    laws: Mapping[str, Law]
    plant: Plant
    unknowns: Unknowns
    shift: Array  #: d of each statement, (n,).

    def linear_numbers(self, values: Values, plant: Plant) -> LoopNumbers:
        """The stated numbers of the linear loops of a machine with these values.

        Bandwidths are those of the response, also of an unstable loop: a fit must pass through it.
        """
        linear_by_cab: dict[str, Linear] = {}
        laws = {name: self.unknowns.apply(values, law) for name, law in self.laws.items()}
        loops_by_case: dict[tuple[str, str, str], tuple[Any, Measures]] = {}
        value, stable = np.full(len(self.statements), np.nan), np.zeros(len(self.statements), bool)
        for i, statement in enumerate(self.statements):
            law, cab = laws[statement.law], statement.cab
            if cab not in linear_by_cab:
                linear_by_cab[cab] = Linear(self._plant_with(cab, values, plant), friction="none")
            if statement.field == LEAST_DAMPING:
                leg_loop = linear_by_cab[cab].leg_loop(law)
                poles = np.asarray(leg_loop.poles(), dtype=complex)
                value[i], stable[i] = _least_damping(poles, leg_loop.dt), are_stable(poles)
                continue
            case = statement.law, statement.dof, cab
            if case not in loops_by_case:
                loops_by_case[case] = _measure_loop(linear_by_cab[cab], law, statement.dof)
            loop, measures = loops_by_case[case]
            stable[i] = measures.stable
            if statement.field in MEASURES:
                value[i] = getattr(measures, statement.field)
            else:
                at_line = loop_response(loop, np.array([statement.frequency]))
                response = complex(at_line.frdata.item())
                gain, phase = 20.0 * np.log10(abs(response)), np.degrees(np.angle(response))
                value[i] = gain if statement.field == "gain_db" else phase
        return LoopNumbers(value + self.shift, stable)

    def simulated_numbers(self, values: Values, plant: Plant, jobs: int) -> Array:
        """The stated numbers of the simulation; those that are no measures are linear."""
        value = self.linear_numbers(values, plant).value
        of_measures = [statement for statement in self.statements if statement.field in MEASURES]
        case_keys = list(dict.fromkeys((each.law, each.dof, each.cab) for each in of_measures))
        cases = []
        for law_name, dof, cab in case_keys:
            plant_with_cab = self._plant_with(cab, values, plant)
            law = bound(self.unknowns.apply(values, self.laws[law_name]), plant_with_cab)
            carried = plant_with_cab.cab_parameters or load_cab(None, plant.machine)
            cases.append(make_case(law, dof, plant.name, carried, plant.parameters, quick=True))
        results = dict(zip(case_keys, on_threads(run_case, cases, jobs), strict=True))
        for i, statement in enumerate(self.statements):
            if statement.field in MEASURES:
                result = results[statement.law, statement.dof, statement.cab]
                measures = result.measures
                if result.response is not None:
                    measures = _with_bandwidths(measures, bandwidths(result.response))
                value[i] = getattr(measures, statement.field)
        return value

    def with_shift(self, jobs: int) -> "Evidence":
        """With d of the data sheet's machine; 0 where a simulation has no such number."""
        plain = self._replace(shift=np.zeros(len(self.statements)))
        simulated = plain.simulated_numbers({}, self.plant, jobs)
        shift = simulated - plain.linear_numbers({}, self.plant).value
        return self._replace(shift=np.where(np.isfinite(shift), shift, 0.0))

    def excess(self, values: Values, plant: Plant) -> Array:
        """The errors e of the statements that are fitted."""
        predicted = self.linear_numbers(values, plant).value.tolist()
        pairs = zip(self.statements, predicted, strict=True)
        return np.array([each.excess(value) for each, value in pairs if not each.held_back])

    def _plant_with(self, cab: str, values: Values, plant: Plant) -> Plant:
        """The machine with a cab by name, or as it is without one."""
        if not cab:
            return plant
        carried = load_cab(cab, plant.machine)
        return Hexapod(self.unknowns.apply(values, carried), plant.parameters)


def _measure_loop(linear: Linear, law: Law, dof: str) -> tuple[Any, Measures]:
    """The loop of a degree of freedom, on single legs that of the first, and its measures."""
    loop = linear.loop(law, dof if isinstance(linear.plant, Hexapod) else "leg_1")
    measures = measure_loop(loop, frequencies=LINES, duration=_STEP)
    if not measures.stable:
        measures = _with_bandwidths(measures, bandwidths(loop_response(loop, LINES)))
    return loop, measures


def _least_damping(poles: NDArray[np.complex128], frame: float) -> float:
    """Least damping ratio of the modes of the machine; 1 of a stable loop that has none."""
    ratio = least_damped_mode(poles, _FASTEST_HZ, frame=frame).damping_ratio
    return 1.0 if np.isnan(ratio) and are_stable(poles) else ratio


def _with_bandwidths(measures: Measures, widths: Bandwidths) -> Measures:
    """Measures with bandwidths also where the step rings on."""
    of_response = measures_from(widths)
    return measures._replace(**{name: getattr(of_response, name) for name in _RESPONSE_MEASURES})


def load_evidence(
    tables: Mapping[str, EvidenceSettings],
    deviations: Deviations,
    law: str,
    folder: Path,
    plant: Plant,
    unknowns: Unknowns,
) -> Evidence:
    """Make the statements of a campaign, `law` being its own; files lie in `folder`."""
    statements: list[Statement] = []
    laws: dict[str, Law] = {}
    for name, settings in tables.items():
        with within(f"evidence.{name}"):
            law_name = settings.law or law
            laws[law_name] = load_law(beside(folder, law_name))
            if settings.cabs and not isinstance(plant, Hexapod):
                raise InputError("cabs: is refused: single legs carry none; allowed: a hexapod")
            for cab in settings.cabs:
                load_cab(cab, plant.machine)
            numbers = _statements(name, settings, settings.deviations or deviations, law_name)
            fields = sorted({statement.field for statement in numbers})
            for field in settings.held_back:
                if field not in fields:
                    allowed = ", ".join(fields)
                    raise InputError(f"held_back: {field!r} is not stated; allowed: {allowed}")
            statements += numbers
    no_shift = np.zeros(len(statements))
    return Evidence(tuple(statements), laws, plant, unknowns, no_shift)


def _statements(
    name: str, settings: EvidenceSettings, deviations: Deviations, law: str
) -> list[Statement]:
    """The numbers that one piece of evidence states."""
    statements: list[Statement] = []

    def state(field: str, title: str, value: float, cab: str, frequency: float = 0.0) -> None:
        statement = Statement(
            evidence=name,
            quantity=f"{title}, {cab}" if cab else title,
            field=field,
            law=law,
            dof=settings.dof,
            cab=cab,
            frequency=frequency,
            value=value,
            deviation=getattr(deviations, field),
            held_back=field in settings.held_back,
        )
        statements.append(statement)

    for cab in settings.cabs or ("",):
        for field, title in (MEASURES | {LEAST_DAMPING: "least zeta"}).items():
            value = getattr(settings, field)
            if value is not None:
                state(field, title, value, cab)
        for hertz, gain, phase in settings.response:
            state("gain_db", f"gain at {hertz:g} Hz [dB]", gain, cab, hertz)
            state("phase_deg", f"phase at {hertz:g} Hz [deg]", phase, cab, hertz)
    if not statements:
        allowed = ", ".join([*MEASURES, LEAST_DAMPING, "response"])
        raise InputError(f"states nothing; allowed: {allowed}")
    return statements
