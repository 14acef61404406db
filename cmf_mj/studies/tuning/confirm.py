"""What a law found on linear plants does in the whole simulation: its -90 deg, axis by axis.

A sine is simulated at the predicted -90 deg. By what it shows over the linear loop's response there
the whole response is corrected; where that falls through -90 deg is the next sine, two at least.
Sines above and below -90 deg bound the next: where a limit of the law begins to act phases jump.

Legs are to slide as fast as the describing function assumes. At speed amplitudes v_i friction F
takes 2 F sum v_i / pi, and its damping 4 F / (pi V) takes 2 F sum v_i^2 / (pi V), so that V is
sum v_i^2 / sum v_i. Stuck legs move by `STUCK` of the presliding travel, those without friction at
`SHARE` of their largest speed. A demand keeps the legs' largest speed and `STROKE` of their stroke.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.analysis.frequency_response import line_bandwidths
from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.analysis.measurable import dof_history
from cmf_mj.analysis.measures import are_stable
from cmf_mj.analysis.periodic import fit_sines
from cmf_mj.control.law import Law
from cmf_mj.core.errors import NoPoseError, RunError
from cmf_mj.core.result import Field, Result, fields_of
from cmf_mj.core.threads import on_threads
from cmf_mj.facility.simulate import simulate
from cmf_mj.machine.cab import Cab
from cmf_mj.machine.geometry import DOFS, dof_index
from cmf_mj.plant.cylinder import Contact
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.signals import sine
from cmf_mj.studies.engine import libraries

CLOSE, NARROW = 0.3, 1.01
"""Distance of a sine from -90 deg at which its frequency counts as found [deg]; ratio of two sines
about -90 deg from which on it does too."""
SHARE, STUCK, STROKE = 0.05, 0.1, 0.1
"""Shares of leg speed, presliding travel and working stroke."""
_ABOUT = (
    "linear: of small motion on the linearised machine, as `cmf linearize` and, in brackets, `cmf "
    f"compare` have it; simulated: of sines that move legs at {SHARE:.0%} of their largest speed, "
    "or as --friction says; legs at: their speed then; assumed: that of the prediction, by which "
    "friction counts. The larger sweeps of `cmf compare` open the valves wider and read "
    "another -90 deg. -3 dB and margins are linear too, as `cmf linearize` has them. All is at "
    "neutral, of the machine as its file has it: `cmf certify` asks how far it may be off, and in "
    "other poses."
)
_LINES = np.geomspace(0.2, 50.0, 500)  # [Hz]
_ROUNDS, _FADE, _SETTLED, _CYCLES = 10, 0.5, 2.0, 8
_DIFFERS = 0.1  # from the assumed speed, to speak of


class Confirmation(NamedTuple):
    """One axis of a cab."""

    cab: str
    dof: str
    predicted_hz: Annotated[float, Field(title="linear\n-90 deg", form=".2f Hz")] = np.nan
    simulated_hz: Annotated[float, Field(title="simulated\n-90 deg", form=".2f Hz")] = np.nan
    difference: Annotated[float, Field(form="+.1f %", unit="%")] = np.nan
    leg_speed: Annotated[float, Field(title="legs\nat", form=".3g m/s")] = np.nan
    """V of the last sine [m/s]."""
    assumed: Annotated[float, Field(form=".3g m/s")] = np.nan
    """V of the prediction [m/s]; NaN without friction."""
    gain_hz: Annotated[float, Field(title="linear\n-3 dB", form=".2f Hz")] = np.nan
    gain_margin: Annotated[float, Field(title="gain\nmargin", form=".1f dB")] = np.nan
    phase_margin: Annotated[float, Field(title="phase\nmargin", form=".0f deg")] = np.nan
    remark: str = ""  #: What keeps the two from being compared.


def confirm(
    law: Law,
    cabs: Sequence[str | Path | Cab],
    friction: Contact | None = None,
    dofs: Sequence[str] = DOFS,
) -> Result[Confirmation]:
    """Simulate the -90 deg of a law that linear plants predict; `friction` as `linearize` takes it.

    The simulation has the machine's friction; it is left out where nothing is predicted.
    """
    rows = []
    for cab in cabs:
        linear = Linear(Hexapod(cab), friction=friction)
        loop, response = linear.loop(law), np.full((len(DOFS), _LINES.size), np.nan + 0j)
        if are_stable(loop.poles()):
            response = np.einsum("iik->ik", loop(np.exp(2j * np.pi * _LINES * loop.dt)))
        with libraries().limit(limits=1):  # systems are small: threads would only wait
            found = on_threads(partial(_confirmed, law, cab, linear, response), list(dofs))
            margins = linear.margins(law, dofs)
        for one, (gain, phase) in zip(found, margins, strict=True):
            width = line_bandwidths(_LINES, response[dof_index(one.dof)]).gain_hz
            more = {"gain_hz": width, "gain_margin": gain, "phase_margin": phase}
            rows.append(one if one.remark == "unstable" else one._replace(**more))
    title = f"-90 deg of {law.name} in small motion, linear and simulated"
    return Result(rows, fields_of(Confirmation), title, _ABOUT, grouped=True)


def _confirmed(
    law: Law, cab: str | Path | Cab, linear: Linear, responses: NDArray[np.complex128], dof: str
) -> Confirmation:
    plant, response = Hexapod(cab), responses[dof_index(dof)]
    predicted = hertz = line_bandwidths(_LINES, response).phase_hz
    if np.isnan(predicted):
        said = "unstable" if np.isnan(response).all() else "none below 50 Hz"
        return Confirmation(plant.cab, dof, remark=said)
    ends, found, speed, assumed = [_LINES[0], _LINES[-1]], np.nan, np.nan, np.nan
    for last in range(_ROUNDS):
        before = np.interp(hertz, _LINES, response)
        size, assumed = _amplitude(linear, dof, hertz, abs(before))
        try:
            shown, speed = _sine(plant, law, dof, size, hertz)
        except (RunError, NoPoseError):
            break
        above = np.angle(1j * shown, deg=True)
        ends[int(above < 0.0)] = hertz
        if last and (abs(above) < CLOSE or ends[1] < NARROW * ends[0]):
            found = hertz
            break
        response = response * (shown / before)
        hertz = line_bandwidths(_LINES, response).phase_hz
        if not ends[0] < hertz < ends[1]:
            hertz = float(np.sqrt(ends[0] * ends[1]))
    remarks = {
        "friction left out": linear.friction == "none"
        and plant.hydraulics.friction.coulomb_friction.any(),
        "other speed than assumed": abs(speed / assumed - 1.0) > _DIFFERS,
        "no -90 deg found": np.isnan(found),
    }
    numbers = predicted, found, found / predicted - 1.0, speed, assumed
    said = "; ".join(text for text, holds in remarks.items() if holds)
    return Confirmation(plant.cab, dof, *numbers, remark=said)


def _amplitude(linear: Linear, dof: str, hertz: float, gain: float) -> tuple[float, float]:
    """Amplitude of a demand [m or rad], and the speed V that the prediction assumes [m/s]."""
    machine, rate, assumed = linear.plant.machine, 2.0 * np.pi * hertz, np.nan
    fastest = machine.limits.leg.velocity.si
    if linear.friction == "stuck":
        assumed = rate * STUCK * float(linear.plant.hydraulics.friction.presliding.min())
    elif linear.friction not in (None, "none"):
        assumed = float(linear.friction)
    asked = (SHARE * fastest if np.isnan(assumed) else assumed) / gain
    asked = min(asked, fastest, rate * STROKE * machine.working_stroke)
    return asked / (rate * _speed(linear.jacobian[:, dof_index(dof)])), assumed


def _speed(legs: NDArray[np.complex128] | NDArray[np.float64]) -> float:
    return float((np.abs(legs) ** 2).sum() / np.abs(legs).sum())


def _sine(plant: Hexapod, law: Law, dof: str, size: float, hertz: float) -> tuple[complex, float]:
    """Response that a sine shows, and the speed V of its legs [m/s]."""
    end = _SETTLED + _CYCLES / hertz
    command = sine(dof, size, hertz, cycles=(end + _FADE) * hertz, fade=_FADE)
    record = simulate(plant, law, command, record_every=4)
    rows = (record.time >= _SETTLED) & (record.time < end)
    pair = [dof_history(record, name, dof) for name in ("leg_reference", "leg_position")]
    values = np.column_stack([*pair, record["leg_velocity"]])[rows]
    fit = fit_sines(values, 2.0 * np.pi * hertz * record.time[rows], drift=True)
    asked, moved, *legs = fit.amplitude[0]
    return moved / asked, _speed(np.array(legs))
