"""Replay: the DCL runs open loop on recorded feedback.

    recorded reference, feedback -> DCL -> compensator output, to compare with the recorded one

The law that made a record starts in the state in which the record says it began, so that at the
control rate its output comes back bit for bit. Any other starts engaged at the first sample.
A recording at a lower rate, such as the facility's 128 Hz, is brought to the machine's rate by
cubic splines, which cannot be exact: what lay between the samples is lost.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from cmf_mj.analysis.modes import bound
from cmf_mj.control.dcl import DclState, make_dcl, step
from cmf_mj.control.engage import engaged_state
from cmf_mj.control.feedback import LegFeedback
from cmf_mj.control.law import Law, load_law
from cmf_mj.core.arrays import real, shaped
from cmf_mj.core.compiled import allocating
from cmf_mj.core.errors import InputError
from cmf_mj.core.settings import validated
from cmf_mj.electronics.chain import gravity_history
from cmf_mj.electronics.sensors import at_frame
from cmf_mj.machine.cab import recorded_cab
from cmf_mj.machine.machine import recorded_machine
from cmf_mj.record.record import Record

FEEDBACK = {
    "position": "leg_position",
    "velocity": "leg_velocity",
    "acceleration": "leg_acceleration",
    "cap_pressure": "cap_pressure",
    "rod_pressure": "rod_pressure",
}
"""Feedback of the DCL and the channels it is recorded in."""

_SIGNALS = {
    "velocity": ("velocity", "velocity_error"),
    "acceleration": ("acceleration",),
    "cap_pressure": ("cap_pressure", "force"),
    "rod_pressure": ("rod_pressure", "force"),
}
"""Signals of the compensator that a kind of feedback acts through; the position always acts."""


class Replay(NamedTuple):
    """A law's answer to recorded feedback."""

    law: str  #: Name of the law.
    time: NDArray[np.float64]  #: Times of the record [s], (N,).
    output: NDArray[np.float64]  #: Compensator output, command fraction, (N, n).
    recorded: NDArray[np.float64] | None  #: That of the record, where it has one.
    interpolated: bool  #: Whether the recording was below the control rate.
    factor: NDArray[np.float64]
    """Factor of an adapting law on its feed-forward, (N, n); 1 for any other."""

    @property
    def difference(self) -> float:
        """Largest difference of the two outputs; NaN where nothing was recorded."""
        if self.recorded is None:
            return float("nan")
        return float(np.abs(self.output - self.recorded).max())

    @property
    def identical(self) -> bool:
        """Whether the recorded output came back bit for bit."""
        return self.recorded is not None and self.output.tobytes() == self.recorded.tobytes()


@allocating
def _run(dcl, state, reference, feedback, output, factor):  # type: ignore[no-untyped-def]
    """Run the DCL on every frame; overwrite `state`, `output` and `factor`, (N, n)."""
    for frame in range(reference.shape[0]):
        for leg in range(reference.shape[1]):
            factor[frame, leg] = 1.0 + state.model.adaptation.factor[leg]
        now = at_frame(feedback, frame)
        step(dcl, state, reference[frame], now)
        output[frame] = dcl.workspace.output


def replay(record: Record, law: str | Law | None = None) -> Replay:
    """Run a law on the recorded demand and feedback of a run, by default the law that made it.

    The record has `leg_reference`, `leg_position` and whatever else the law reads, at the control
    rate or a whole fraction of it.
    """
    metadata = record.metadata
    machine, cab = recorded_machine(metadata), recorded_cab(metadata)
    if law is None:
        if "law_parameters" not in metadata:
            raise InputError("law: the recording does not say which law made it; name one")
        law = validated(Law, metadata["law_parameters"], "law_parameters")
    carrier = cab.assumed if cab else str(metadata.get("plant", ""))
    loaded = bound(load_law(law, machine), carrier).for_machine(machine)
    ratio = machine.rate / record.rate
    if not (ratio >= 1.0 and ratio.is_integer()):
        allowed = f"allowed: {machine.rate} Hz over an integer"
        raise InputError(f"sample_rate: {record.rate} Hz; {allowed}")
    frames_per_row = int(ratio)
    feedback = _feedback_histories(record, loaded)
    reference = _leg_histories(record, "leg_reference")
    if frames_per_row > 1:
        reference = _interpolated(reference, frames_per_row)
        feedback = LegFeedback(*(_interpolated(history, frames_per_row) for history in feedback))
    frames, legs = reference.shape
    dcl = make_dcl(loaded, legs)
    first_feedback = LegFeedback(*(history[0].copy() for history in feedback))
    state = _recorded_state(record, loaded, legs) or engaged_state(
        dcl, reference[0], first_feedback
    )
    output, factor = np.empty((frames, legs)), np.empty((frames, legs))
    _run(dcl, state, reference, feedback, output, factor)
    has_output = "compensator_output" in record.channels
    recorded = _leg_histories(record, "compensator_output") if has_output else None
    rows = slice(None, None, frames_per_row)
    row_output = np.ascontiguousarray(output[rows])
    return Replay(loaded.name, record.time, row_output, recorded, frames_per_row > 1, factor[rows])


def _recorded_state(record: Record, law: Law, legs: int) -> DclState | None:
    """The state in which the law began; None where the record has none, or that of another law."""
    table = record.metadata.get("law_state")
    if not table or record.metadata.get("law_parameters") != law.model_dump(mode="json"):
        return None
    names = DclState.zeros(legs).arrays().keys()
    state = {name: real(f"law_state: {name}", values) for name, values in table.items()}
    has_all = state.keys() == names and all(x.shape == (legs,) for x in state.values())
    return DclState.of(state) if has_all else None


def _leg_histories(record: Record, channel: str) -> NDArray[np.float64]:
    """A copy of a channel with a column for each leg, (N, n), finite and as long as positions."""
    rows, legs = shaped("leg_position", record["leg_position"], None, None).shape
    if rows < 2:
        raise InputError(f"leg_position: has {rows} rows; allowed: at least 2")
    return shaped(channel, record[channel], rows, legs)


def _feedback_histories(record: Record, law: Law) -> LegFeedback:
    """Histories (N, n) of what the DCL reads; zeros of what is neither recorded nor needed.

    What gravity adds to accelerometers is added to recorded accelerations where the law of the
    record read them without gravity and this law reads them with it, and subtracted in the
    opposite case.
    """
    histories = {}
    for field, channel in FEEDBACK.items():
        if channel in record.channels:
            histories[field] = _leg_histories(record, channel)
        elif _reads(law, field):
            text = f"is not recorded, and the law {law.name} reads it"
            raise InputError(f"{channel}: {text}; recorded: {', '.join(record.channels)}")
        else:
            histories[field] = np.zeros(record["leg_position"].shape)
    metadata = record.metadata
    sensors = (metadata.get("electronics") or {}).get("sensors", {})
    compensated = metadata.get("law_parameters", {}).get("gravity_compensation", True)
    sign = int(bool(compensated)) - int(law.gravity_compensation)
    is_recorded = FEEDBACK["acceleration"] in record.channels
    if sign and is_recorded and sensors.get("gravity", False):
        position = _leg_histories(record, "leg_position")
        histories["acceleration"] += sign * gravity_history(position, recorded_machine(metadata))
    return LegFeedback(**histories)


def _reads(law: Law, field: str) -> bool:
    if field.endswith("_pressure") and law.load_feedback is not None:
        return True
    tables, signals = (law.direct_gain, law.input_gain), _SIGNALS.get(field, ())
    gains = [getattr(table, signal) for table in tables for signal in signals]
    is_read = field == "position" or (field == "velocity" and law.reads_velocity)
    return is_read or any(map(np.any, gains))


def _interpolated(values: NDArray[np.float64], frames_per_row: int) -> NDArray[np.float64]:
    """Cubic splines through the rows (M, n), with a row for each frame from first to last row."""
    rows = np.arange(values.shape[0])
    frames = np.arange((values.shape[0] - 1) * frames_per_row + 1) / frames_per_row
    return np.ascontiguousarray(CubicSpline(rows, values, axis=0)(frames))
