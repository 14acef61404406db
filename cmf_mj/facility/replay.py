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

_NEEDS = {
    "velocity": ("velocity", "velocity_error"),
    "acceleration": ("acceleration",),
    "cap_pressure": ("cap_pressure", "force"),
    "rod_pressure": ("rod_pressure", "force"),
}
"""Signals of the compensator that a feedback acts through; the position always acts."""


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
    made = record.metadata
    cab = recorded_cab(made)
    carrier = recorded_machine(made)
    if law is None:
        if "law_parameters" not in made:
            raise InputError("law: the recording does not say which law made it; name one")
        law = validated(Law, made["law_parameters"], "law_parameters")
    loaded = bound(load_law(law, carrier), cab.assumed if cab else str(made.get("plant", "")))
    loaded, ratio = loaded.for_machine(carrier), carrier.rate / record.rate
    if not (ratio >= 1.0 and ratio.is_integer()):
        allowed = f"allowed: {carrier.rate} Hz over an integer"
        raise InputError(f"sample_rate: {record.rate} Hz; {allowed}")
    frames_per_row = int(ratio)
    histories = _feedback(record, loaded)
    reference = _legs(record, "leg_reference")
    if frames_per_row > 1:
        reference = _interpolated(reference, frames_per_row)
        histories = LegFeedback(*(_interpolated(h, frames_per_row) for h in histories))
    frames, legs = reference.shape
    dcl = make_dcl(loaded, legs)
    first = LegFeedback(*(history[0].copy() for history in histories))
    state = _begun(record, loaded, legs) or engaged_state(dcl, reference[0], first)
    output = np.empty((frames, legs))
    factor = np.empty((frames, legs))
    _run(dcl, state, reference, histories, output, factor)
    known = "compensator_output" in record.channels
    recorded = _legs(record, "compensator_output") if known else None
    rows = slice(None, None, frames_per_row)
    picked = np.ascontiguousarray(output[rows])
    return Replay(loaded.name, record.time, picked, recorded, frames_per_row > 1, factor[rows])


def _begun(record: Record, law: Law, legs: int) -> DclState | None:
    """The state in which the law began; none where the record does not say, or of another law."""
    said = record.metadata.get("law_state")
    if not said or record.metadata.get("law_parameters") != law.model_dump(mode="json"):
        return None
    known = DclState.zeros(legs).arrays()
    begun = {name: real(f"law_state: {name}", values) for name, values in said.items()}
    fits = begun.keys() == known.keys() and all(v.shape == (legs,) for v in begun.values())
    return DclState.of(begun) if fits else None


def _legs(record: Record, channel: str) -> NDArray[np.float64]:
    """A copy of a channel with a column for each leg, (N, n), finite and as long as positions."""
    rows, legs = shaped("leg_position", record["leg_position"], None, None).shape
    if rows < 2:
        raise InputError(f"leg_position: has {rows} rows; allowed: at least 2")
    return shaped(channel, record[channel], rows, legs)


def _feedback(record: Record, law: Law) -> LegFeedback:
    """Histories (N, n) of what the DCL reads; zeros of what is neither recorded nor needed.

    What gravity adds to accelerometers is added to recorded accelerations where the law of the
    record read them without gravity and this law reads them with it, and subtracted in the
    opposite case.
    """
    histories = []
    for field, channel in FEEDBACK.items():
        acting = field == "position" or (field == "velocity" and law.reads_velocity)
        acting |= field.endswith("_pressure") and law.load_feedback is not None
        for gains in (law.direct_gain, law.input_gain):
            acting |= any(np.any(getattr(gains, name)) for name in _NEEDS.get(field, ()))
        present = channel in record.channels
        if acting and not present:
            said = f"is not recorded, and the law {law.name} reads it"
            raise InputError(f"{channel}: {said}; recorded: {', '.join(record.channels)}")
        still = np.zeros(record["leg_position"].shape)
        histories.append(_legs(record, channel) if present else still)
    read = LegFeedback(*histories)
    made = record.metadata
    sensors = (made.get("electronics") or {}).get("sensors", {})
    compensated = made.get("law_parameters", {}).get("gravity_compensation", True)
    shift = int(bool(compensated)) - int(law.gravity_compensation)
    recorded = FEEDBACK["acceleration"] in record.channels
    if shift and recorded and sensors.get("gravity", False):
        felt = gravity_history(_legs(record, "leg_position"), recorded_machine(made))
        read.acceleration[:] += shift * felt
    return read


def _interpolated(values: NDArray[np.float64], frames_per_row: int) -> NDArray[np.float64]:
    """Cubic splines through the rows (M, n), with a row for each frame from first to last row."""
    coarse = np.arange(values.shape[0])
    fine = np.arange((values.shape[0] - 1) * frames_per_row + 1) / frames_per_row
    return np.ascontiguousarray(CubicSpline(coarse, values, axis=0)(fine))
