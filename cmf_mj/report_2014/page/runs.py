"""The runs behind the figures and tables: each made once, shared by all that need it.

Two plants stand for the report's two sources. The `model` is its non-linear model, six single legs
with the `report` hydraulics; the `machine` is a stand-in for the hardware, the hexapod with the GFD
and the `hardware` hydraulics. Runs share nothing and go on threads; results do not depend on how
many there are.

Figures 3-15 and 3-16 need what the leg accelerometers read before and behind the filter of the DCL.
The filter y[k+1] = a y[k] + b x[k] (Eq 3.6) has the frequency response

    H(f) = b / (exp(2 pi i f T) - a)

and leaves of white noise the share b / sqrt(1 - a^2).
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, Literal, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from cmf_mj import signals
from cmf_mj.analysis.frequency_response import FrequencyResponse, rounds_response
from cmf_mj.analysis.identification.model import Orders
from cmf_mj.analysis.periodic import fit_sines
from cmf_mj.control.feedback import LegFeedback
from cmf_mj.control.law import Law, load_law
from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.core.threads import on_threads
from cmf_mj.core.units import FRAME, STANDARD_GRAVITY
from cmf_mj.electronics.sensors import SensorSettings, load_sensors, make_sensors, sense_history
from cmf_mj.facility.replay import FEEDBACK
from cmf_mj.facility.simulate import simulate
from cmf_mj.machine.leg_motion import axial_gravity
from cmf_mj.plant.hexapod import Hexapod, make_plant
from cmf_mj.plant.plant import Plant
from cmf_mj.record.record import Record
from cmf_mj.signals import composite
from cmf_mj.studies.case import RECORD_EVERY, CaseResult, dof_amplitude, make_case, run_case
from cmf_mj.studies.identification import Identified, identify

_AMPLITUDE, _FREQUENCY = 0.33 * units.INCH, 1.2
"""Heave motion of Figure 3-16 [m, Hz] (section 3.4.1)."""


class Readings(NamedTuple):
    """Leg accelerometers before and behind the DCL's filter, (N, 6) [m/s^2]."""

    truth: NDArray[np.float64]  #: Without bandwidth, bias, noise, resolution and range.
    raw: NDArray[np.float64]
    filtered: NDArray[np.float64]


class SensorReadings(NamedTuple):
    """Readings of the accelerometers at rest and in motion."""

    rest: Readings  #: Platform still at neutral.
    motion: Readings  #: Heave of 0.33 in at 1.2 Hz, five whole cycles.
    numbers: dict[str, Any]
    """What captions say of them: `mean`, `gravity` by Appendix C [g], `raw` and `filtered` rms at
    rest [mg], shares of `noise` and `signal` that the filter leaves [%], its `delay` at 1.2 Hz and
    the `predicted` one, -arg H / (2 pi f) [ms]."""


def _readings(
    truth: LegFeedback, settings: SensorSettings, law: Law, seed: int, skip: int
) -> Readings:
    """Read histories, filter from rest on the first sample, leave out the first `skip` frames."""
    perfect = SensorSettings(name="perfect", gravity=settings.gravity)
    clean, raw = (
        sense_history(make_sensors(which, 1.0 / FRAME, seed), truth).acceleration
        for which in (perfect, settings)
    )
    a, b = law.accelerometer_pole, law.accelerometer_gain
    filtered, _ = lfilter([0.0, b], [1.0, -a], raw, axis=0, zi=b / (1.0 - a) * raw[:1])
    return Readings(clean[skip:], raw[skip:], filtered[skip:])


def sensor_readings(
    sensors: str = "noisy", *, seed: int = 0, duration: float = 60.0
) -> SensorReadings:
    """Read and filter the leg accelerometers at rest and in the motion of Figure 3-16.

    Acceleration feedback with Eq 3.6 moves the hexapod with its default cab on true feedback;
    `seed` is of the noise, `duration` the time at rest [s].
    """
    signals.check_positive(duration=duration)
    settings, law, plant = load_sensors(sensors), load_law("acceleration_opposing"), Hexapod()
    sine = signals.sine("heave", _AMPLITUDE, _FREQUENCY, cycles=12, fade=2.0 / _FREQUENCY)
    hold, moving = (
        LegFeedback(*(simulated[channel] for channel in FEEDBACK.values()))
        for simulated in (simulate(plant, law, command) for command in (np.zeros((2, 6)), sine))
    )
    settle = round(0.5 / FRAME)
    frames = round(duration / FRAME) + settle
    still = LegFeedback(*(np.tile(channel[0], (frames, 1)) for channel in hold))
    rest = _readings(still, settings, law, seed, settle)
    skip, end = (round(cycles / (_FREQUENCY * FRAME)) for cycles in (4, 9))
    motion = _readings(LegFeedback(*(c[:end] for c in moving)), settings, law, seed, skip)
    turn = 2.0 * np.pi * _FREQUENCY
    angle = turn * FRAME * np.arange(len(motion.raw))
    raw, filtered = (fit_sines(v, angle).amplitude[0] for v in (motion.raw, motion.filtered))
    ratio = filtered.sum() / raw.sum()
    predicted = law.accelerometer_gain / (np.exp(1j * turn * FRAME) - law.accelerometer_pole)
    noise = [float(np.sqrt(np.mean(v.var(axis=0)))) for v in (rest.raw, rest.filtered)]
    numbers = {
        "sensors": settings.name,
        "mean": float(rest.raw.mean()) / STANDARD_GRAVITY,
        "gravity": float(axial_gravity(np.zeros(6)).mean()) / STANDARD_GRAVITY,
        "raw": 1e3 * noise[0] / STANDARD_GRAVITY,
        "filtered": 1e3 * noise[1] / STANDARD_GRAVITY,
        "amplitude": units.from_si("in", _AMPLITUDE),
        "frequency": _FREQUENCY,
        "noise": 100.0 * noise[1] / noise[0] if noise[0] > 0.0 else float("nan"),
        "signal": 100.0 * float(abs(ratio)),
        "delay": 1e3 * float(-np.angle(ratio) / turn),
        "predicted": 1e3 * float(-np.angle(predicted) / turn),
    }
    return SensorReadings(rest, motion, numbers)


Array = NDArray[np.float64]

On = Literal["model", "machine"]
Signal = Literal["case", "rise", "sine", "pulse", "sine_1_hz", "sine_5_hz", "rounds", "multisine"]

HYDRAULICS: Mapping[On, str] = {"model": "report", "machine": "hardware"}
"""Hydraulic sets of the two plants."""

PLANTS: Mapping[On, str] = {"model": "single_legs", "machine": "hexapod"}
"""The two plants."""

CAB = "gfd"
"""Cab of the machine."""

STEP = 1.0 * units.INCH
"""Steps, pulses and slow sines of the report [m]."""

SLOW, FIRST, FAST = 0.5, 1.0, 5.0
"""Sines of Figures 3-10 and 3-22, of linear model 2, and of Figure 4-7 [Hz]."""

IDENTIFIED_ON: Mapping[int, Signal] = {1: "pulse", 2: "sine_1_hz", 3: "rounds"}
"""Signals of the report's linear models 1 to 3 (section 4.3)."""

ORDERS = Orders(4, 3, 1)
"""Of our models of a leg: two lags and the oil mode."""

LEG = "leg_1"
"""The leg whose motion figures show."""


class RunSpec(NamedTuple):
    """One run; `case` is the chirp and step of a case, `rounds` the five of Table 2-3."""

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
    sensors: SensorReadings | None
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
    }
    return [makers[spec.signal]()]


def _perform(spec: RunSpec, quick: bool, seed: int) -> CaseResult | tuple[Record, ...]:
    machine = PLANTS[spec.on], CAB, HYDRAULICS[spec.on]
    if spec.signal == "case":
        return run_case(make_case(spec.law, spec.dof, *machine, quick=quick))
    plant, commands = make_plant(*machine), _commands(spec, quick, seed)
    every = 1 if spec.signal in ("rise", "sine_5_hz") else RECORD_EVERY
    return tuple(simulate(plant, spec.law, command, record_every=every) for command in commands)


def perform(
    specs: Iterable[RunSpec],
    *,
    sensors: bool = False,
    jobs: int | None = None,
    quick: bool = False,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Runs:
    """Make all runs, one asked for twice once; `progress` is called with (done, in all).

    Results do not depend on the number of threads, `jobs`. With `sensors` the accelerometers of
    Figures 3-15 and 3-16 are read too; `quick` sweeps 30 s for 100 s and shortens the rounds.
    """
    if seed < 0:
        raise InputError(f"seed: {seed} must be at least 0")
    # The longest first, so that no thread is left with one at the end.
    order = sorted(set(specs), key=lambda w: (w.signal != "rounds", w.on != "machine", w))
    total = len(order) + int(sensors)
    results = on_threads(
        lambda one: _perform(one, quick, seed),
        order,
        jobs,
        progress and (lambda done, _: progress(done, total)),
    )
    readings = sensor_readings(seed=seed, duration=5.0 if quick else 60.0) if sensors else None
    if progress is not None and sensors:
        progress(total, total)
    return Runs(dict(zip(order, results, strict=True)), readings, quick, seed)


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
