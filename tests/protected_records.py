"""The protection run on the readings that a record holds."""

from cmf_mj.control.feedback import LegFeedback
from cmf_mj.control.protection import (
    Fault,
    Protection,
    check_frame,
    latched_fault,
    protection_state,
)
from cmf_mj.core.compiled import allocating
from cmf_mj.electronics.chain import gravity_history
from cmf_mj.electronics.sensors import at_frame
from cmf_mj.facility import replay
from cmf_mj.machine.machine import recorded_machine
from cmf_mj.record.record import Record


@allocating
def _watch(protection, state, reference, feedback, supply_pressure):  # type: ignore[no-untyped-def]
    for frame in range(reference.shape[0]):
        now = at_frame(feedback, frame)
        check_frame(protection, state, frame, reference[frame], now, supply_pressure)


def fault_of(record: Record, protection: Protection, supply_pressure: float) -> Fault | None:
    """The fault that the protection detects in a record at 2048 Hz, or none."""
    assert record.rate == 2048.0
    reference = replay._leg_histories(record, "leg_reference")
    readings = (replay._leg_histories(record, name) for name in replay.FEEDBACK.values())
    histories = LegFeedback(*readings)
    made = record.metadata
    felt = (made.get("electronics") or {}).get("sensors", {}).get("gravity", False)
    if felt and not made["law_parameters"]["gravity_compensation"]:
        machine = recorded_machine(made)
        histories.acceleration[:] -= gravity_history(histories.position, machine)
    state = protection_state(histories.position[0])
    _watch(protection, state, reference, histories, supply_pressure)
    return latched_fault(state)
