"""What the README says of acceleration feedback, measured."""

import numpy as np
import pytest

from cmf_mj import Hexapod, signals, simulate


def decay_rate(law: str, dof: str) -> float:
    """Mean rate [1/s] at which the largest leg swing of a small step shrinks from 4 to 10 s."""
    size = 0.05 * 0.0254 if dof in ("surge", "sway", "heave") else np.radians(0.03)
    record = simulate(Hexapod("gfd"), law, signals.step(dof, size, duration=12.0), record_every=8)
    legs, rate = record["leg_position"], round(record.rate)
    early, late = (float(np.ptp(legs[t * rate : (t + 1) * rate], axis=0).max()) for t in (5, 11))
    return float(np.log(early / late) / 6.0)


@pytest.mark.parametrize("dof", ["surge", "pitch", "roll"])
def test_the_sign_of_acceleration_feedback_decides_the_damping_of_the_heavy_pair(dof: str) -> None:
    """Printed sign: the pair grows. Opposing sign: it dies at least three times as fast."""
    without = decay_rate("position_error_rate", dof)
    assert without > 0.0
    assert decay_rate("acceleration_eq_3_6", dof) < 0.0
    assert decay_rate("acceleration_opposing", dof) > 3.0 * without
