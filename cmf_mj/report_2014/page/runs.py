"""The runs behind the figures and tables: each made once, shared by all that need it.

Two plants stand for the report's two sources. The `model` is its non-linear model, six single legs
with the `report` hydraulics; the `machine` is a stand-in for the hardware, the hexapod with the GFD
and the `hardware` hydraulics. Runs share nothing and go on threads; results do not depend on how
many there are.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, Literal, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from cmf_mj import signals
from cmf_mj.analysis.frequency_response import FrequencyResponse, rounds_response
from cmf_mj.analysis.identification.model import Orders
from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.core.threads import on_threads
from cmf_mj.core.units import RATE
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.facility.simulate import simulate
from cmf_mj.plant.hexapod import make_plant
from cmf_mj.plant.plant import Plant
from cmf_mj.record.record import Record
from cmf_mj.signals import composite
from cmf_mj.studies.case import RECORDER, CaseResult, dof_amplitude, make_case, run_case
from cmf_mj.studies.identification import Identified, identify

Array = NDArray[np.float64]

On = Literal["model", "machine"]
Signal = Literal[
    "case",
    "rise",
    "sine",
    "pulse",
    "sine_1_hz",
    "sine_5_hz",
    "rounds",
    "multisine",
    "felt_rest",
    "felt_sine",
]

HYDRAULICS: Mapping[On, str] = {"model": "report", "machine": "hardware"}
"""Hydraulic sets of the two plants."""

PLANTS: Mapping[On, str] = {"model": "single_legs", "machine": "hexapod"}  #: The two plants.

CAB = "gfd"  #: Cab of the machine.

STEP = 1.0 * units.INCH  #: Steps, pulses and slow sines of the report [m].

SLOW, FIRST, FELT, FAST = 0.5, 1.0, 1.2, 5.0
"""Sines of Figures 3-10 and 3-22, of linear model 2, of Figures 3-16 and 4-7 [Hz]."""

REST = 20.0  #: Rest of Figure 3-15 [s].

IDENTIFIED_ON: Mapping[int, Signal] = {1: "pulse", 2: "sine_1_hz", 3: "rounds"}
"""Signals of the report's linear models 1 to 3 (section 4.3)."""

ORDERS = Orders(4, 3, 1)  #: Of our models of a leg: two lags and the oil mode.

LEG = "leg_1"  #: The leg whose motion figures show.


class RunSpec(NamedTuple):
    """One run; `case` is the chirp and step of a case, `rounds` the five of Table 2-3.

    In those that begin with `felt` the control law has noisy sensors.
    """

    on: On
    law: str
    dof: str = "heave"
    signal: Signal = "case"


def specs(*lines: str) -> tuple[RunSpec, ...]:
    """Runs from lines of `plant law dof signal`: commas between several; last two heave, case."""
    return tuple(
        RunSpec(*chosen)  # type: ignore[arg-type]
        for line in lines
        for chosen in product(*(part.split(",") for part in line.split()))
    )


def report_plant(on: On) -> Plant:
    """A new plant."""
    return make_plant(PLANTS[on], CAB, HYDRAULICS[on])


@dataclass(frozen=True)
class Runs:
    """Results of all runs asked for."""

    results: Mapping[RunSpec, Any]
    quick: bool
    seed: int

    def case(self, on: On, law: str, dof: str = "heave") -> CaseResult:
        """Chirp and step."""
        return cast("CaseResult", self.results[RunSpec(on, law, dof)])

    def records(self, on: On, law: str, signal: Signal) -> tuple[Record, ...]:
        """The records of a signal in heave: one, of `rounds` five."""
        return cast("tuple[Record, ...]", self.results[RunSpec(on, law, "heave", signal)])

    def record(self, on: On, law: str, signal: Signal) -> Record:
        """A single record."""
        return self.records(on, law, signal)[0]

    def rounds(self, law: str) -> FrequencyResponse:
        """The machine's response in heave from the five rounds of sines."""
        return rounds_response(self.records("machine", law, "rounds"))

    def measured(self, signal: Signal) -> tuple[Array, ...]:
        """Time, command less its mean [%], position [in], velocity [in/s], acceleration [g].

        Of leg 1 of the machine. The five rounds of the sweep are put end to end, as section 4.3.3
        says.
        """
        records = self.records("machine", "velocity", signal)
        begins = np.cumsum([0.0, *(record.time.size / record.rate for record in records[:-1])])
        time = [r.time - r.time[0] + begin for r, begin in zip(records, begins, strict=True)]
        command = np.concatenate([record["valve_command"][:, 0] for record in records])
        legs = zip(*map(leg_signals, records), strict=True)
        return np.concatenate(time), 100.0 * (command - command.mean()), *map(np.concatenate, legs)

    @cached_property
    def identified(self) -> dict[int, Identified]:
        """Our linear models 1 to 3 of the machine's leg, made as the report made its models."""
        validation = self.record("machine", "velocity", "multisine")
        options: dict[str, Any] = {"method": "arx", "orders": ORDERS, "law": "velocity"}
        return {
            number: identify(
                [*self.records("machine", "velocity", signal), validation], LEG, **options
            )
            for number, signal in IDENTIFIED_ON.items()
        }


def _commands(spec: RunSpec, quick: bool, seed: int) -> list[signals.Command]:
    dof, size = spec.dof, dof_amplitude(spec.dof)
    shorter: dict[str, Any] = {"cycles": 3, "settle": 1.0} if quick else {}
    if spec.signal == "rounds":
        numbers = range(1, len(composite.ROUNDS) + 1)
        return [composite.seven_sines(dof, size, number, **shorter) for number in numbers]
    makers: dict[Signal, Callable[[], signals.Command]] = {
        "rise": lambda: signals.step(dof, -STEP),
        "sine": lambda: signals.sine(dof, STEP, SLOW, cycles=5.0),
        "pulse": lambda: signals.pulse(dof, STEP),
        "sine_1_hz": lambda: signals.sine(dof, STEP, FIRST),
        "sine_5_hz": lambda: signals.sine(dof, size, FAST, cycles=20.0),
        "multisine": lambda: signals.multisine(
            dof, size, stop=16.0, spectrum="acceleration", fade=1.0, seed=seed
        ),
        "felt_rest": lambda: signals.Command.from_pose(np.zeros((round(REST * RATE), 6))),
        "felt_sine": lambda: signals.sine(dof, size, FELT, cycles=12, fade=2.0 / FELT),
    }
    return [makers[spec.signal]()]


def _perform(spec: RunSpec, quick: bool, seed: int) -> CaseResult | tuple[Record, ...]:
    machine = PLANTS[spec.on], CAB, HYDRAULICS[spec.on]
    if spec.signal == "case":
        return run_case(make_case(spec.law, spec.dof, *machine, quick=quick))
    plant, commands = make_plant(*machine), _commands(spec, quick, seed)
    felt = spec.signal.startswith("felt")
    how: dict[str, Any] = {"record_every": RATE // RECORDER}
    if felt or spec.signal in ("rise", "sine_5_hz"):
        how["record_every"] = 1
    if felt:
        how["electronics"] = ElectronicsSettings(converters="off", seed=seed)
    return tuple(simulate(plant, spec.law, command, **how) for command in commands)


def perform(
    specs: Iterable[RunSpec],
    *,
    jobs: int | None = None,
    quick: bool = False,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Runs:
    """Make all runs, one asked for twice once; `progress` is called with (done, in all).

    Results do not depend on the number of threads, `jobs`; `quick` sweeps 30 s for 100 s and
    shortens the rounds.
    """
    if seed < 0:
        raise InputError(f"seed: {seed} must be at least 0")
    # The longest first, so that no thread is left with one at the end.
    order = sorted(set(specs), key=lambda w: (w.signal != "rounds", w.on != "machine", w))
    results = on_threads(lambda one: _perform(one, quick, seed), order, jobs, progress)
    return Runs(dict(zip(order, results, strict=True)), quick, seed)


def leg_motion(record: Record, channel: str, unit: str) -> Array:
    """A channel of leg 1 (N,) in `unit`, positive out."""
    return units.from_si(unit, record[channel][:, 0])


def leg_signals(record: Record) -> tuple[Array, ...]:
    """Position [in], velocity [in/s] and acceleration [g] of leg 1."""
    channels = (("leg_position", "in"), ("leg_velocity", "in/s"))
    acceleration = record["leg_acceleration"][:, 0] / units.STANDARD_GRAVITY
    return (*(leg_motion(record, channel, unit) for channel, unit in channels), acceleration)


def after_step(record: Record) -> Array:
    """Time from the step on [s]; of other signals from the begin."""
    return np.asarray(record.time - getattr(record.signal, "at", 0.0))
