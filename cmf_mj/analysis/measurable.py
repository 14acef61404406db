"""What a record must be like to be measured, and which lines of it can be."""

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

DRIVEN_SHARE = 1e-2
"""Demand power over its largest line from which on a line of single sines counts as driven."""

EXCITED_SHARE = 1e-5
"""Likewise for any excitation: a multisine of equal accelerations has 1e-4 at ten times its corner.
"""

_ELASTIC = 0.05  #: What legs may be beyond their stops, which give way [m].

NO_DEMAND = 1e-9
"""Demand [m or rad] that is round-off of the transformation to a degree of freedom."""

CLEAR = 0.8
"""Coherence from which on a line is read: below it, the report's estimator is 1 dB high or more."""

_ALIKE = (
    *("machine", "machine_parameters", "plant", "cab", "cab_parameters", "hydraulics"),
    *("hydraulic_parameters", "law", "law_parameters", "command_delay", "events"),
)
"""What the metadata of rounds must agree in, as far as they tell."""


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
        most = recorded_machine(record.metadata).half_stroke + _ELASTIC
        beyond = np.abs(values) > most
        if beyond.any():
            row, leg = np.argwhere(beyond)[0]
            raise InputError(
                f"{channel}: {values[row, leg]:g} m of leg {leg + 1} in row {row} is refused; "
                f"allowed: within its stops, +-{most:g} m"
            )
    return values


def least_demand(record: Record, dof: str) -> float:
    """Range of a demand [m or rad] from which on it can be measured.

    A file's last decimal q rounds each leg by up to q/2, which moves a degree of freedom by up to
    q sum_j |(J^-1)_j|; ten times that is 1 dB of round-off at most.
    """
    spread, last = 1.0, record.metadata.get("recording", {}).get("last_place", 0.0)
    if not dof.startswith("leg_"):
        jacobian = pose_jacobian(np.zeros(6), recorded_machine(record.metadata))
        spread = float(np.abs(np.linalg.inv(jacobian)[dof_index(dof)]).sum())
    return max(10.0 * last * spread, NO_DEMAND)


def check_alike(records: Sequence[Record]) -> None:
    """Refuse rounds that cannot be of one session, as far as they tell."""
    sources = [{"axis": record.excitation.axis or None, **record.metadata} for record in records]
    for field in ("axis", *_ALIKE):
        values = [of[field] for of in sources if of.get(field) is not None]
        for other in values:
            if other != values[0]:
                pair = f"{values[0]!r} and {other!r} " if isinstance(other, str) else ""
                raise InputError(f"records: {field}: {pair}differ; rounds are of one session")
    held = [record["leg_position"].tobytes() for record in records]
    if len(set(held)) < len(held):
        first, last = next((held.index(one), k) for k, one in enumerate(held) if one in held[:k])
        raise InputError(
            f"records: {first + 1} and {last + 1} hold the same samples; a round counts once"
        )


def demand_share(
    demand: NDArray[np.float64], rate: float, frequency: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Power of a demand (N,) at lines [Hz] over that of the strongest of them."""
    size = min(round(SEGMENT * rate), demand.size)
    _, power = signal.welch(demand, rate, nperseg=size)
    spectrum = np.interp(frequency, np.arange(power.size) * rate / size, power)
    return np.asarray(spectrum / spectrum.max())
