"""Tables, figures and files of a measuring session and of measured responses."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from rich.box import SIMPLE_HEAD
from rich.table import Table

from cmf_mj.analysis.frequency_response import (
    FrequencyResponse,
    bandwidths,
)
from cmf_mj.analysis.metrics import SecondOrder
from cmf_mj.core import units
from cmf_mj.core.files import write_csv, write_json
from cmf_mj.machine.dof import by_kind, dof_unit
from cmf_mj.machine.kinematics import DOFS
from cmf_mj.show.look import save_figure
from cmf_mj.studies.measurement import Measurement, plain
from cmf_mj.studies.recordings import RecordingMeasures


def _share(value: float) -> str:
    return f"{100.0 * value:.2f} %"


def _field(dof: str) -> tuple[str, str]:
    """The field's units of displacement and acceleration for a degree of freedom."""
    return dof_unit(dof), by_kind(dof, "m/s^2", "deg/s^2")


def response_table(title: str, response: FrequencyResponse, fit: SecondOrder) -> Table:
    """Bandwidths, peak and second-order fit of one response."""
    widths = bandwidths(response)
    table = Table("measure", "value", "definition", title=title, box=SIMPLE_HEAD)
    rows = (
        ("-90 deg bandwidth", f"{widths.phase_hz:.3f} Hz", "first fall of the phase through it"),
        ("-3 dB bandwidth", f"{widths.gain_hz:.3f} Hz", "first fall through it, from 0 dB"),
        ("peak", f"{widths.peak_db:.2f} dB", "largest gain"),
        ("coherence", f"{response.coherence.min():.4f}", "least of all lines"),
        ("natural frequency", f"{fit.natural_frequency_hz:.3f} Hz", "second-order fit with delay"),
        ("damping ratio", f"{fit.damping_ratio:.3f}", "second-order fit with delay"),
        ("fit residual", _share(fit.residual), "rms misfit over rms response"),
    )
    for row in rows:
        table.add_row(*row)
    return table


def recordings_table(measures: RecordingMeasures) -> Table:
    """Bandwidths, peak and second-order fit of recordings."""
    title = f"{measures.dof}: {', '.join(path.name for path in measures.files)}"
    return response_table(title, measures.response, measures.second_order)


def measurement_table(measured: Measurement) -> Table:
    """Every measure of a session with its definition."""
    machine = " ".join(part for part in (measured.plant, measured.cab, measured.hydraulics) if part)
    title = f"{measured.law} in {measured.dof}, {machine}"
    table = response_table(title, measured.response, measured.second_order)
    length, turn = _field(measured.dof)
    step = measured.step
    rows = [
        ("overshoot", _share(step.overshoot), "of the step, over the final value"),
        ("damping ratio", f"{step.damping_ratio:.3f}", "from the overshoot"),
        ("steady-state error", _share(step.steady_state_error), "demanded minus reached"),
        ("rise time", f"{step.rise_time:.3f} s", "10 to 90 % of the step"),
        ("settling time", f"{step.settling_time:.3f} s", "into 2 % of the final value"),
        ("stable", str(step.stable), "legs at rest or decaying 12 s after the step"),
        ("delay", f"{1e3 * measured.transport_delay:.1f} ms", "cross-correlation of the sweep"),
        ("hysteresis", _share(measured.hysteresis), "loop width at 0.01 Hz, over peak-to-peak"),
    ]
    for amplitude, noise in measured.half_hertz_noise:
        size = f"{units.from_si(length, amplitude):.3g} {length}"
        rows += [
            (f"half-hertz noise, {size}", _share(noise.total), "acceleration, all of the below"),
            ("  low harmonics", _share(noise.low_harmonics), "2 and 3"),
            ("  high harmonics", _share(noise.high_harmonics), "4 and up"),
            ("  stochastic", _share(noise.stochastic), "no harmonic"),
            ("  peak", _share(noise.peak), "largest deviation from the fundamental"),
        ]
    for point in measured.threshold:
        level = point.acceleration / (1.0 if turn == "m/s^2" else units.DEGREE)
        time = f"{1e3 * point.time:.1f} ms"
        rows.append((f"dynamic threshold, {level:.3g} {turn}", time, "to 63 % of the step"))
    for dof, value in zip(DOFS, measured.crosstalk[DOFS.index(measured.dof)], strict=True):
        if dof != measured.dof:
            same = dof_unit(dof) == dof_unit(measured.dof)
            text = _share(value) if same else f"{value:.4f} SI"
            rows.append((f"crosstalk into {dof}", text, "acceleration at 1 Hz, rms over rms"))
    for row in rows:
        table.add_row(*row)
    return table


def response_figure(title: str, responses: Mapping[str, FrequencyResponse]) -> Figure:
    """Gain and phase with their 95 % bounds, and coherence, of measured responses."""
    figure = Figure(figsize=(8.0, 8.0), layout="constrained")
    gain, phase, coherence = figure.subplots(3, 1, sharex=True, height_ratios=(3, 3, 1))
    for name, response in responses.items():
        (line,) = gain.semilogx(response.frequency, response.gain_db, label=name)
        phase.semilogx(response.frequency, response.phase_deg, color=line.get_color())
        coherence.semilogx(response.frequency, response.coherence, color=line.get_color())
        share = np.minimum(response.bound / np.abs(response.response), 0.99)
        far, near = (response.gain_db + 20.0 * np.log10(1.0 + sign * share) for sign in (1, -1))
        gain.fill_between(response.frequency, near, far, color=line.get_color(), alpha=0.2)
        half = np.degrees(np.arcsin(share))
        low, high = response.phase_deg - half, response.phase_deg + half
        phase.fill_between(response.frequency, low, high, color=line.get_color(), alpha=0.2)
    gain.axhline(-3.0, color="0.6", linewidth=0.8)
    phase.axhline(-90.0, color="0.6", linewidth=0.8)
    gain.set(ylabel="gain [dB]", title=title)
    phase.set(ylabel="phase [deg]")
    coherence.set(ylabel="coherence", xlabel="frequency [Hz]", ylim=(0.0, 1.05))
    for axis in (gain, phase, coherence):
        axis.grid(True, which="both", color="0.9", linewidth=0.6)
    gain.legend(fontsize=8)
    return figure


def measures_figure(measured: Measurement) -> Figure:
    """Describing function, half-hertz noise, dynamic threshold and crosstalk of a session."""
    figure = Figure(figsize=(10.0, 7.0), layout="constrained")
    (gain, noise), (threshold, cross) = figure.subplots(2, 2)
    length, turn = _field(measured.dof)
    for frequency in dict.fromkeys(point.frequency_hz for point in measured.describing_function):
        points = [p for p in measured.describing_function if p.frequency_hz == frequency]
        sizes = [units.from_si(length, p.amplitude) for p in points]
        gain.semilogx(sizes, [p.gain_db for p in points], "o-", label=f"{frequency:g} Hz")
    gain.set(title="describing function", xlabel=f"amplitude [{length}]", ylabel="gain [dB]")
    gain.legend(fontsize=8)
    sizes = [units.from_si(length, amplitude) for amplitude, _ in measured.half_hertz_noise]
    for field in ("low_harmonics", "high_harmonics", "stochastic", "peak"):
        shares = [100.0 * getattr(item, field) for _, item in measured.half_hertz_noise]
        noise.loglog(sizes, shares, "o-", label=field.replace("_", " "))
    noise.set(title="half-hertz noise", xlabel=f"amplitude [{length}]", ylabel="of A1 [%]")
    noise.legend(fontsize=8)
    scale = 1.0 if turn == "m/s^2" else units.DEGREE
    threshold.semilogx(
        [point.acceleration / scale for point in measured.threshold],
        [1e3 * point.time for point in measured.threshold],
        "o-",
    )
    threshold.set(title="dynamic threshold", xlabel=f"step [{turn}]", ylabel="time to 63 % [ms]")
    threshold.set_ylim(0.0, 1200.0 * max((p.time for p in measured.threshold), default=1.0))
    image = cross.imshow(np.log10(np.maximum(measured.crosstalk, 1e-6)), vmin=-3, vmax=0)
    cross.set_xticks(range(6), DOFS, fontsize=8)
    cross.set_yticks(range(6), DOFS, fontsize=8)
    cross.set(title="crosstalk at 1 Hz", xlabel="moved", ylabel="driven")
    figure.colorbar(image, ax=cross, label="log10 acceleration ratio [SI]")
    steps = [point.acceleration / scale for point in measured.threshold]
    for axis, ticks in ((gain, sizes), (noise, sizes), (threshold, steps)):
        axis.set_xticks(ticks, [f"{tick:.3g}" for tick in ticks])
        axis.minorticks_off()
        axis.grid(True, color="0.9", linewidth=0.6)
    return figure


def write_response(response: FrequencyResponse, path: Path) -> None:
    """Write a response as CSV: frequency, gain, phase, coherence, radius of the 95 % circle."""
    curves = (response.frequency, response.gain_db, response.phase_deg)
    columns = (*curves, response.coherence, response.bound)
    header = ("frequency_hz", "gain_db", "phase_deg", "coherence", "radius_95")
    write_csv(path, header, zip(*columns, strict=True))


def save_recordings(measures: RecordingMeasures, folder: Path) -> list[Path]:
    """Write `response.csv`, `response.png` and `summary.json`."""
    paths = [folder / name for name in ("response.csv", "response.png", "summary.json")]
    write_response(measures.response, paths[0])
    save_figure(
        response_figure(measures.dof, {measures.files[0].stem: measures.response}), paths[1]
    )
    write_json(paths[2], plain(measures.summary()))
    return paths


def save_measurement(measured: Measurement, folder: Path) -> list[Path]:
    """Write `response.csv`, `response.png`, `measures.png` and `summary.json`."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / n for n in ("response.csv", "response.png", "measures.png", "summary.json")]
    write_response(measured.response, paths[0])
    title = f"{measured.law}, {measured.dof}"
    response_figure(title, {measured.plant: measured.response}).savefig(paths[1], dpi=110)
    measures_figure(measured).savefig(paths[2], dpi=110)
    write_json(paths[3], measured.summary())
    return paths
