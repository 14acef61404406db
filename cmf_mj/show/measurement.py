"""Tables, figures and files of a measuring session and of measured responses."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from cmf_mj.analysis.frequency_response import FrequencyResponse, bandwidths
from cmf_mj.analysis.measurable import CLEAR
from cmf_mj.analysis.measures import Measures, joined
from cmf_mj.analysis.metrics import SecondOrder
from cmf_mj.core import units
from cmf_mj.core.table import Table, number
from cmf_mj.machine.dof import by_kind, dof_unit
from cmf_mj.machine.geometry import DOFS
from cmf_mj.show.comparison import quality_rows
from cmf_mj.show.look import dress_bode, legend, plot_band, plot_bode, save_files, stack
from cmf_mj.studies.measurement import Measurement, RecordingMeasures, plain

_COLUMNS = ("measure", "value", "definition")


def _share(value: float) -> str:
    return f"{100.0 * value:.2f} %"


def _response_rows(
    response: FrequencyResponse, widths: Measures, fit: SecondOrder | None
) -> list[tuple[str, str, str]]:
    coherence = ("coherence", f"{response.coherence.min():.4f}", "least of all lines")
    if fit is None:
        return [coherence]
    first, second = widths.phase_bandwidth_hz, "second-order fit with delay"
    rows = [("-90 deg bandwidth", number(first, ".3f Hz"), "first fall of the phase through it")]
    if widths.later_phase_hz == widths.later_phase_hz:
        later = number(widths.later_phase_hz, ".3f Hz")
        rows.append(("-90 deg, later", later, "last fall through it, after coming back"))
    if widths.graze_from_hz == widths.graze_from_hz:
        ends = f"{widths.graze_from_hz:.2f} to {widths.graze_to_hz:.2f} Hz"
        rows.append(("-90 deg, grazed", ends, "the phase lingers within 10 deg of it"))
    return [
        *rows,
        ("-3 dB bandwidth", number(widths.gain_bandwidth_hz, ".3f Hz"), "from 0 dB"),
        ("peak", f"{widths.peak_gain_db:.2f} dB", "largest gain"),
        coherence,
        ("natural frequency", f"{fit.natural_frequency_hz:.3f} Hz", second),
        ("damping ratio", f"{fit.damping_ratio:.3f}", second),
        ("fit residual", _share(fit.residual), "rms misfit over rms response"),
    ]


def recordings_table(measures: RecordingMeasures) -> Table:
    """Bandwidths, peak and second-order fit of recordings."""
    title = f"{measures.dof}: {', '.join(path.name for path in measures.files)}"
    response = measures.response
    rows = _response_rows(response, joined(bandwidths(response)), measures.second_order)
    why = f"not excited, or of a coherence below {CLEAR:g}"
    rows.append(("lines left out", str(measures.left_out), why))
    return Table(title, _COLUMNS, rows)


def measurement_table(measured: Measurement) -> Table:
    """Every measure of a session with its definition."""
    dof, step = measured.case.dof, measured.measures
    unit, turn = dof_unit(dof), by_kind(dof, "m/s^2", "deg/s^2")
    rows = [
        ("stable", str(step.stable), "legs at rest or decaying 12 s after the step"),
        *_response_rows(measured.response, step, measured.second_order),
    ]
    if step.stable:
        rows += [
            ("overshoot", _share(step.overshoot), "of the step, over the final value"),
            ("damping ratio", f"{step.damping_ratio:.3f}", "from the overshoot"),
            ("steady-state error", _share(step.steady_state_error), "demanded minus reached"),
            ("rise time", f"{step.rise_time:.3f} s", "10 to 90 % of the step"),
            ("settling time", f"{step.settling_time:.3f} s", "into 2 % of the final value"),
        ]
    rows += [
        ("delay", f"{1e3 * measured.transport_delay:.1f} ms", "cross-correlation of the sweep"),
        ("hysteresis", _share(measured.hysteresis), "loop width at 0.01 Hz, over peak-to-peak"),
        *quality_rows(dof, measured.qualities),
    ]
    for at in measured.describing_function:
        size = f"{at.frequency_hz:g} Hz, {units.from_si(unit, at.amplitude):.3g} {unit}"
        value = f"{at.gain_db:.2f} dB, {at.phase_deg:.1f} deg"
        rows.append((f"describing function, {size}", value, "fundamental over the demand"))
    for amplitude, noise in measured.half_hertz_noise:
        size = f"{units.from_si(unit, amplitude):.3g} {unit}"
        rows += [
            (f"half-hertz noise, {size}", _share(noise.total), "acceleration, all of the below"),
            ("  low harmonics", _share(noise.low_harmonics), "2 and 3"),
            ("  high harmonics", _share(noise.high_harmonics), "4 and up"),
            ("  stochastic", _share(noise.stochastic), "no harmonic"),
            ("  peak", _share(noise.peak), "largest deviation from the fundamental"),
        ]
    for point in measured.threshold:
        level = f"{point.acceleration / by_kind(dof, 1.0, units.DEGREE):.3g} {turn}"
        time = f"{1e3 * point.time:.1f} ms"
        rows.append((f"dynamic threshold, {level}", time, "to 63 % of the step"))
    for other, value in zip(DOFS, measured.crosstalk[DOFS.index(dof)], strict=True):
        if other != dof:
            same = dof_unit(other) == unit
            text = _share(value) if same else f"{value:.4f} SI"
            rows.append((f"crosstalk into {other}", text, "acceleration at 1 Hz, rms over rms"))
    case = measured.case
    machine = " ".join(part for part in (case.plant, case.cab_name, case.hydraulics.name) if part)
    return Table(f"{case.law.name} in {dof}, {machine}", _COLUMNS, rows)


def response_figure(title: str, name: str, response: FrequencyResponse) -> Figure:
    """Gain and phase of a measured response with their 95 % bounds, and its coherence."""
    labels, ratios = ("gain [dB]", "phase [deg]", "coherence"), (3, 3, 1)
    figure, axes = stack(8.0, 8.0, *labels, x="frequency [Hz]", ratios=ratios)
    gain, phase, coherence = axes
    dress_bode(gain, phase, title, limits=True)
    phase.set_xlabel("")
    colour = plot_bode(gain, phase, response, label=name)
    coherence.plot(response.frequency, response.coherence, color=colour)
    coherence.set_ylim(0.0, 1.05)
    share = np.minimum(response.bound / np.abs(response.response), 0.99)
    plot_band(gain, phase, response, share, np.arcsin(share), color=colour)
    legend(gain)
    return figure


def _response_files(response: FrequencyResponse, figure: Figure) -> dict[str, Any]:
    """`response.csv`, with the radius of the 95 % circle, and `response.png`."""
    curves = (response.frequency, response.gain_db, response.phase_deg)
    columns = (*curves, response.coherence, response.bound)
    header = ("frequency_hz", "gain_db", "phase_deg", "coherence", "radius_95")
    return {"response.csv": (header, zip(*columns, strict=True)), "response.png": figure}


def save_recordings(measures: RecordingMeasures, folder: Path) -> list[Path]:
    """Write `response.csv`, `response.png` and `summary.json`."""
    figure = response_figure(
        f"Frequency response in {measures.dof}", measures.files[0].stem, measures.response
    )
    files = _response_files(measures.response, figure)
    return save_files(files | {"summary.json": plain(measures.summary())}, folder)


def save_measurement(measured: Measurement, folder: Path) -> list[Path]:
    """Write `response.csv`, `response.png` and `summary.json`."""
    case, stable = measured.case, measured.measures.stable
    title = f"Frequency response in {case.dof}, {case.law.title}" + ("" if stable else ", unstable")
    figure = response_figure(title, measured.case.plant, measured.response)
    files = _response_files(measured.response, figure)
    return save_files(files | {"summary.json": measured.summary()}, folder)
