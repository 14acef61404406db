"""Conditions on a record for its measures, and the motion along an axis that it holds."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from cmf_mj.analysis.spectra import SEGMENT
from cmf_mj.core.arrays import shaped
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.machine.geometry import dof_index
from cmf_mj.machine.kinematics import legs_to_pose, pose_jacobian
from cmf_mj.machine.machine import recorded_machine
from cmf_mj.record.record import Record

DRIVEN_SHARE = 1e-2  #: Demand power over its largest line from which a line of sines counts.
EXCITED_SHARE = 1e-5  #: Likewise of any excitation; a multisine has 1e-4 at ten times its corner.
_STOP_TRAVEL = 0.05  #: How far legs may be beyond their stops, which give way [m].
NO_DEMAND = 1e-9  #: Demand [m or rad] that is round-off of the transformation from the legs.
LEAST_COHERENCE = 0.8  #: Of a line that is read; at this one the report's estimator is 1 dB high.
_SESSION_FIELDS = (
    *("machine", "machine_parameters", "plant", "cab", "cab_parameters", "hydraulics"),
    *("hydraulic_parameters", "law", "law_parameters", "command_delay", "events"),
)
"""Fields of the metadata in which rounds must agree, where they have them."""


def dof_history(record: Record, channel: str, dof: str) -> NDArray[np.float64]:
    """A leg channel (N, 6) along a degree of freedom, or of one leg, `leg_1` and so on, (N,)."""
    values = checked_legs(record, channel, dof)
    if not dof.startswith("leg_"):
        return legs_to_pose(values, recorded_machine(record.metadata))[:, dof_index(dof)]
    legs = [f"leg_{i + 1}" for i in range(values.shape[1])]
    check_name("dof", dof, legs)
    return values[:, legs.index(dof)]


def checked_legs(record: Record, channel: str, dof: str) -> NDArray[np.float64]:
    """A leg channel (N, n) of finite numbers; for a degree of freedom none is beyond the stops."""
    values = shaped(channel, record[channel], None, None)
    if values.size == 0:
        raise InputError(f"{channel}: shape is {values.shape}; allowed: rows of a number a leg")
    if not dof.startswith("leg_"):
        limit = recorded_machine(record.metadata).half_stroke + _STOP_TRAVEL
        beyond_stops = np.argwhere(np.abs(values) > limit)
        if beyond_stops.size:
            row, leg = beyond_stops[0]
            raise InputError(
                f"{channel}: {values[row, leg]:g} m of leg {leg + 1} in row {row} is refused; "
                f"allowed: within its stops, +-{limit:g} m"
            )
    return values


def least_demand(record: Record, dof: str) -> float:
    """Range of a demand [m or rad] from which on it can be measured.

    Ten times q sum_j |(J^-1)_j|, by which a file's last decimal q rounds it: 1 dB at most.
    """
    rounding, last_place = 1.0, record.metadata.get("recording", {}).get("last_place", 0.0)
    if not dof.startswith("leg_"):
        jacobian = pose_jacobian(np.zeros(6), recorded_machine(record.metadata))
        rounding = float(np.abs(np.linalg.inv(jacobian)[dof_index(dof)]).sum())
    return max(10.0 * last_place * rounding, NO_DEMAND)


def check_one_session(records: Sequence[Record]) -> None:
    """Refuse rounds whose metadata or samples show that they are not of one session."""
    tables = [{"axis": record.excitation.axis or None, **record.metadata} for record in records]
    for field in ("axis", *_SESSION_FIELDS):
        values = [table[field] for table in tables if table.get(field) is not None]
        for value in values:
            if value != values[0]:
                pair = f"{values[0]!r} and {value!r} " if isinstance(value, str) else ""
                raise InputError(f"records: {field}: {pair}differ; rounds are of one session")
    round_by_samples = dict[bytes, int]()
    for number, record in enumerate(records, start=1):
        first_number = round_by_samples.setdefault(record["leg_position"].tobytes(), number)
        if first_number != number:
            pair = f"{first_number} and {number}"
            raise InputError(f"records: {pair} hold the same samples; a round counts once")


def demand_share(
    demand: NDArray[np.float64], rate: float, frequency: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Power of a demand (N,) at lines [Hz] over that of the strongest of them."""
    size = min(round(SEGMENT * rate), demand.size)
    _, power = signal.welch(demand, rate, nperseg=size)
    spectrum = np.interp(frequency, np.arange(power.size) * rate / size, power)
    return np.asarray(spectrum / spectrum.max())
