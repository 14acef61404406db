"""Predictions of recordings that nobody here has seen, and their score when one comes.

`draw` takes machines from a finished `cmf study effects`: its plants averaged by their evidence.
`predict` gives the describing function from the demand of the legs to their position along an axis
at the sines of sealed.toml: of those machines, GFD, velocity law, and of SIMONA's drawn from the
prior stated there. `score RECORDING --test NAME --axis AXIS` compares legs or, where a recording
has none, poses; `--columns MAP` says what its columns are.

A plant with friction, lap or a flow that depends on speed is linear at a speed amplitude V of its
legs, see `report_2014.posterior.effects`; that of a line is where V = w |l| of the six legs'
root mean square. Median and ends are those of the machines at 5, 50 and 95 %. What amplitude else
does, the simulation of the shipped machine over its linear loop, widens both ends by its size.
"""

import argparse
import csv
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj import Hexapod, simulate
from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.analysis.linear.loop import closed_loop
from cmf_mj.analysis.linear.poles import are_stable
from cmf_mj.analysis.modes import bound
from cmf_mj.analysis.periodic import fit_sines
from cmf_mj.analysis.spectra import welch_response
from cmf_mj.control.law import Law, load_law
from cmf_mj.core.settings import read_toml
from cmf_mj.core.tables import write_csv
from cmf_mj.facility.unknowns import Unknowns, load_unknowns
from cmf_mj.machine.cab import load_cab
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.machine import load_machine
from cmf_mj.record.columns import POSES, read_mapped
from cmf_mj.record.record import Record
from cmf_mj.report_2014.posterior import effects
from cmf_mj.report_2014.posterior.effect_run import effects_of, machines_of, run_effects
from cmf_mj.report_2014.posterior.run import Task
from cmf_mj.report_2014.posterior.study import effect_settings, load_effects
from cmf_mj.report_2014.posterior.weighing import Bank
from cmf_mj.signals import stepped_sines
from cmf_mj.studies.fit.sampling import (
    effective_size,
    quantiles,
    resampled,
    weighted_quantiles,
)
from cmf_mj.studies.measurement import demand_and_position

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

ROOT = Path(__file__).resolve().parents[1]
PLAN, DATA = Path(__file__).with_suffix(".toml"), ROOT / "docs" / "data"
MACHINES, SEALED = DATA / "sealed_machines.csv", DATA / "sealed.csv"
LAW = "velocity"  #: Of the CMF; of another machine its own.

SPEEDS = np.geomspace(1e-4, 1.0, 17)  #: Amplitudes of leg speeds at which plants are linear [m/s].
_QUIET = 0.1  # speed amplitude at which a machine must be stable [m/s]
_NEAR = 0.1  # how far a sine's amplitude, and the rest over it, may be off
_WINDOW, _HOPS = 2.0, 16  # shortest window [s]; hops in a window
_RATE = 128.0  # least rate of what is scored [Hz]
_SEGMENT = 10.24  # of Welch's method [s]


class Sine(NamedTuple):
    """A sine of the demand."""

    test: str
    machine: str
    recording: str
    axis: str
    frequency: float  #: [Hz].
    amplitude: float  #: [m or rad].
    run: int  #: Sines of one number are driven together.
    broad: bool  #: Whether it is a line of another signal.
    simulated: bool  #: Whether the shipped machine is simulated too.


class Predicted(NamedTuple):
    """A describing function with its 90 % interval."""

    test: str
    recording: str
    axis: str
    frequency: float
    amplitude: float
    gain: float  #: [dB].
    gain_low: float
    gain_high: float
    phase: float  #: [deg].
    phase_low: float
    phase_high: float


COLUMNS = (
    *("test", "recording", "axis", "frequency [Hz]", "amplitude [m or rad]"),
    *(f"{name} [dB]" for name in ("gain", "gain low", "gain high")),
    *(f"{name} [deg]" for name in ("phase", "phase low", "phase high")),
)


class Drawn(NamedTuple):
    """A machine that predictions are made of."""

    linear: Linear
    law: Law
    effects: Mapping[str, float]  #: By name, in SI.
    times: float  #: How often it was drawn.


class Score(NamedTuple):
    """How a recording compares with what was predicted."""

    lines: int
    gain_inside: float  #: Share of lines whose gain lies within its interval.
    phase_inside: float
    gain_error: float  #: Root mean square, from the median [dB].
    phase_error: float  #: [deg].


@cache
def settled() -> dict[str, Any]:
    """What sealed.toml says."""
    return read_toml(PLAN)


def plan() -> list[Sine]:
    """All sines of sealed.toml."""
    found = []
    for name, one in settled()["tests"].items():
        together, broad = one.get("together", []), one.get("broad", False)
        for axis in one["axes"]:
            turn = one["turn"] if DOFS.index(axis) >= 3 else 1.0
            for size, scale in enumerate(one.get("scales", [1.0])):
                for k, (hz, amplitude) in enumerate(one["sines"]):
                    alone = size * len(one["sines"]) + k
                    of = (
                        int(np.searchsorted(np.cumsum(together), k, "right")) if together else alone
                    )
                    head = name, one["machine"], one["recording"], axis, hz
                    simulated = size < one.get("simulated", 0)
                    found.append(Sine(*head, turn * scale * amplitude, of, broad, simulated))
    return found


def draw(study: Path, out: Path) -> Path:
    """Machines of all plants with at most one effect, in proportion to weight and evidence."""
    bank = run_effects(load_effects("effects"), study)
    settings, shares = effect_settings(bank.study), bank.shares()
    pooled = np.concatenate([share * bank.weights(plant) for plant, share in shares.items()])
    chosen = resampled(pooled, settled()["machines"], settled()["seed"])
    rows, known = [], len(settings.unknowns)
    for place, count in zip(*np.unique(chosen, return_counts=True), strict=True):
        which, i = divmod(int(place), len(bank.points))
        plant, at = list(shares)[which], quantiles(bank.points[i])
        values = bank.study.values(at[:known])
        drawn = {
            n: one.at(u) for (n, one), u in zip(settings.used.items(), at[known:], strict=True)
        }
        own = [float(drawn[n]) if n in plant.split("+") else "" for n in drawn]
        rows.append([i, int(count), plant, *values.values(), *own])
    print(f"{len(rows)} machines; effective sample size {effective_of(bank, shares):.0f}")
    header = ("machine", "count", "plant", *settings.unknowns, *settings.used)
    return write_csv(out, header, rows, digits=17)


def effective_of(bank: Bank, shares: Mapping[str, float]) -> float:
    """Effective number of the machines that all plants share."""
    pooled = np.sum([share * bank.weights(plant) for plant, share in shares.items()], axis=0)
    return effective_size(np.asarray(pooled))


def of_the_report(rows: Iterable[Mapping[str, str]]) -> list[Drawn]:
    """The CMF of rows of MACHINES, with the GFD, as it flies."""
    study, found = load_effects("effects", changes={"cabs": ["gfd"]}), []
    for row in rows:
        values = {name: float(value) for name, value in row.items() if name != "plant" and value}
        number = int(values["machine"])
        task = Task(number, "verdict", values, number, study=study)
        (linear,) = machines_of(task, row["plant"]).values()
        present = effects_of(task, row["plant"])
        flown = {name: x for name, x in present.items() if name not in effects.NOT_FLOWN}
        found.append(Drawn(linear, study.law(load_law(LAW), values), flown, values["count"]))
    return found


def by_prior(name: str, count: int) -> list[Drawn]:
    """A machine by name with the prior of sealed.toml, those that its law can hold."""
    known, sheet = load_unknowns(PLAN), load_machine(name)
    found = []
    for values in known.draw("sobol", count, settled()["seed"]):
        plant = drawn_plant(known, values, name)
        present = {
            one.path.partition("effect.")[2]: float(one.number(0.0, values[key]))
            for key, one in known.items()
            if one.path.startswith("effect.")
        }
        law = bound(known.apply(values, load_law(sheet.law)), plant)
        one = Drawn(Linear(plant), law, present, 1.0)
        part = effects.with_effects(effects.LinearPlant.of(one.linear), present, _QUIET)
        if are_stable(closed_loop(law, part.in_frames).poles()):
            found.append(one)
    return found


def drawn_plant(known: Unknowns, values: Mapping[str, Any], name: str) -> Hexapod:
    """A machine by name with values of its unknowns."""
    shipped = Hexapod(machine=name)
    cab = known.apply(values, load_cab(None, name))
    return Hexapod(cab, known.apply(values, shipped.parameters))


def describing(one: Drawn, sines: Sequence[Sine]) -> Complex:
    """Response of a machine along the axis of each sine, (n,)."""
    part, jacobian = effects.LinearPlant.of(one.linear), one.linear.jacobian
    moving = bool(one.effects.keys() & {"coulomb", "lap", "flow_shape"})
    speeds, delay = SPEEDS if moving else SPEEDS[:1], one.effects.get("reading_delay", 0.0)
    hertz = np.array([sine.frequency for sine in sines])
    axes = np.array([DOFS.index(sine.axis) for sine in sines])
    lines, where = np.unique(hertz, return_inverse=True)
    z = np.exp(2j * np.pi * lines * one.law.frame)[:, None, None]
    legs = np.empty((len(speeds), len(sines), 6), dtype=complex)
    for k, speed in enumerate(speeds):
        loop = closed_loop(one.law, effects.with_effects(part, one.effects, speed).in_frames)
        inside = z * np.eye(loop.nstates) - loop.A
        answers = loop.C @ np.linalg.solve(inside, (loop.B @ jacobian).astype(complex))
        legs[k] = answers[where, :, axes]
    runs = [(sine.test, sine.axis, sine.run) for sine in sines]
    _, of = np.unique([" ".join(map(str, run)) for run in runs], return_inverse=True)
    size = np.array([sine.amplitude for sine in sines])
    found, at = legs[-1], np.log(speeds)
    for _ in range(30 if moving else 1):
        power = (2.0 * np.pi * hertz * size) ** 2 * np.mean(np.abs(found) ** 2, axis=1)
        speed = np.sqrt(np.bincount(of, power))[of]
        place = np.clip(np.interp(np.log(speed), at, np.arange(len(at))), 0.0, len(at) - 1.0)
        low = np.minimum(place.astype(int), max(len(at) - 2, 0))
        share, rows = (place - low)[:, None], np.arange(len(sines))
        new = (1.0 - share) * legs[low, rows] + share * legs[np.minimum(low + 1, len(at) - 1), rows]
        found = 0.5 * (found + new) if moving else new
    along = np.einsum("ki,ki->k", np.linalg.inv(jacobian)[axes], found)
    return np.asarray(along * np.exp(-2j * np.pi * hertz * delay))


def quantile_rows(
    sines: Sequence[Sine], made: Complex, count: Array, wider: Complex
) -> list[Predicted]:
    """Rows of the predictions of machines, (machines, n), each counted so often."""
    rows, at = [], np.array([0.5, 0.05, 0.95])
    for sine, values, more in zip(sines, made.T, wider, strict=True):
        centre = np.angle(np.sum(count * values / np.abs(values)))
        gain = weighted_quantiles(20.0 * np.log10(np.abs(values)), count, at)
        turn = weighted_quantiles(np.angle(values * np.exp(-1j * centre)) + centre, count, at)
        off = np.array([0.0, -1.0, 1.0])
        gain += off * abs(20.0 * np.log10(abs(more)))
        phase = np.degrees(turn + off * abs(np.angle(more)))
        phase -= 360.0 * (phase[0] > 30.0)
        head = sine.test, sine.recording, sine.axis, sine.frequency, sine.amplitude
        rows.append(Predicted(*head, *gain.tolist(), *phase.tolist()))
    return rows


def amplitude_effect(name: str, sines: Sequence[Sine]) -> Complex:
    """Of the shipped machine: simulated response over the linear one; 1 where not asked for."""
    plant, made = Hexapod(machine=name), np.ones(len(sines), dtype=complex)
    law = bound(load_law(LAW if name == "cmf" else load_machine(name).law), plant)
    linear = describing(Drawn(Linear(plant), law, {}, 1.0), sines)
    groups: dict[tuple[str, float], list[int]] = {}
    for k, sine in enumerate(sines):
        if sine.simulated:
            groups.setdefault((sine.axis, sine.amplitude), []).append(k)
    for (axis, amplitude), places in groups.items():
        hertz = sorted(sines[k].frequency for k in places)
        command = stepped_sines(axis, hertz, [amplitude], cycles=3, transient=2.0)
        found = measured(*history(simulate(plant, law, command), axis), [sines[k] for k in places])
        made[places] = found / linear[places]
    return made


def history(record: Record, axis: str) -> tuple[Array, Array, float]:
    """Demand and motion along an axis, and their rate, every few samples."""
    step = max(int(record.rate / _RATE), 1)
    if "leg_reference" in record.channels:
        x, y = demand_and_position(record, axis)
    else:
        x, y = (record[name][:, DOFS.index(axis)] for name in POSES)
    return x[::step], y[::step], record.rate / step


def measured(x: Array, y: Array, rate: float, sines: Sequence[Sine]) -> Complex:
    """Response of a recording at each sine along its axis, NaN where the demand has none, (n,).

    Windows count in which the demand is the sines of a run and nothing more.
    """
    found = np.full(len(sines), np.nan + 0j)
    if sines[0].broad:
        known = welch_response(x - x[0], y - y[0], rate, segment=_SEGMENT)
        at = [int(np.argmin(np.abs(known.frequency - sine.frequency))) for sine in sines]
        return np.asarray(known.response[at])
    for key in dict.fromkeys(sine.run for sine in sines):
        places = [k for k, sine in enumerate(sines) if sine.run == key]
        hertz = np.array([sines[k].frequency for k in places])
        size = np.array([sines[k].amplitude for k in places])
        apart = np.diff(hertz).min() if hertz.size > 1 else hertz[0]
        length = round(max(_WINDOW, 1.0 / min(hertz.min(), apart)) * rate)
        angle = 2.0 * np.pi * np.outer(np.arange(length) / rate, hertz)
        product, power = np.zeros(hertz.size, dtype=complex), np.zeros(hertz.size)
        for first in range(0, x.size - length + 1, max(length // _HOPS, 1)):
            fit = fit_sines(np.column_stack([x, y])[first : first + length], angle)
            driven, moved = fit.amplitude.T
            rest = np.sqrt(2.0 * np.mean(fit.remainder[:, 0] ** 2) / np.sum(size**2))
            if np.all(np.abs(np.abs(driven) / size - 1.0) < _NEAR) and rest < _NEAR:
                product += np.conj(driven) * moved
                power += np.abs(driven) ** 2
        found[places] = np.where(power > 0.0, product / np.maximum(power, 1e-300), np.nan)
    return found


def predict(rows: Iterable[Mapping[str, str]], sines: Sequence[Sine]) -> list[Predicted]:
    """Of all sines, the CMF's from rows of MACHINES."""
    found = list[Predicted]()
    for name in dict.fromkeys(sine.machine for sine in sines):
        own = [sine for sine in sines if sine.machine == name]
        machines = of_the_report(rows) if name == "cmf" else by_prior(name, settled()["machines"])
        made = np.array([describing(one, own) for one in machines])
        count = np.array([one.times for one in machines])
        print(f"{name}: {len(machines)} machines, {len(own)} lines", flush=True)
        found += quantile_rows(own, made, count, amplitude_effect(name, own))
    return found


def score(rows: Sequence[Predicted], found: Complex) -> Score:
    """Of what was found at the sines of the rows; lines without a response do not count."""
    known = np.isfinite(found)
    rows, found = [row for row, k in zip(rows, known, strict=True) if k], found[known]
    table = np.array([row[5:] for row in rows])
    gain = 20.0 * np.log10(np.abs(found)) - table[:, 0]
    turn = np.degrees(np.angle(found * np.exp(-1j * np.radians(table[:, 3]))))
    off = (table[:, 1:3] - table[:, :1]).T, (table[:, 4:6] - table[:, 3:4]).T
    inside = [
        float(np.mean((low <= error) & (error <= high)))
        for error, (low, high) in zip((gain, turn), off, strict=True)
    ]
    return Score(len(rows), *inside, *(float(np.sqrt(np.mean(e**2))) for e in (gain, turn)))


def sealed(test: str, axis: str, file: Path = SEALED) -> list[Predicted]:
    """What was predicted of an axis in a test."""
    with file.open(encoding="utf-8") as lines:
        rows = [list(row.values()) for row in csv.DictReader(lines)]
    return [
        Predicted(row[0], row[1], row[2], *(float(cell) for cell in row[3:]))
        for row in rows
        if (row[0], row[2]) == (test, axis)
    ]


def main() -> None:
    """Draw, predict or score."""
    parser = argparse.ArgumentParser(description=__doc__)
    actions = parser.add_subparsers(dest="action", required=True)
    drawing, making = (actions.add_parser(name) for name in ("draw", "predict"))
    drawing.add_argument("--study", type=Path, default=Path("out/effects"))
    for one in (drawing, making):
        one.add_argument("--out", type=Path, default=Path("out/sealed"))
    scoring = actions.add_parser("score")
    scoring.add_argument("recording", type=Path)
    scoring.add_argument("--test", required=True)
    scoring.add_argument("--axis", required=True, choices=DOFS)
    scoring.add_argument("--columns", help="map of its columns, default the facility's")
    options = parser.parse_args()
    if options.action == "draw":
        print(draw(options.study, options.out / MACHINES.name))
    elif options.action == "predict":
        with MACHINES.open(encoding="utf-8") as file:
            rows = predict(csv.DictReader(file), plan())
        print(write_csv(options.out / SEALED.name, COLUMNS, rows, digits=8))
    else:
        sines = [one for one in plan() if (one.test, one.axis) == (options.test, options.axis)]
        machine = load_machine(sines[0].machine)
        record = read_mapped(options.recording, options.columns, machine)
        found = measured(*history(record, options.axis), sines)
        for name, value in score(sealed(options.test, options.axis), found)._asdict().items():
            print(f"{name:14} {value:.3g}")


if __name__ == "__main__":
    main()
