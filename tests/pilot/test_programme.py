"""The programme of a predictive washout: its linearised legs and pose."""

import numpy as np

from cmf_mj.machine.cab import load_cab
from cmf_mj.machine.kinematics import geometry_about, pose_to_legs
from cmf_mj.machine.machine import load_machine
from cmf_mj.pilot.programme import reach_along


def test_legs_and_pose_along_a_motion_are_those_of_the_centroid():
    """Central differences of the kinematics along a path of the head."""
    station, shape = load_cab().station, load_machine().geometry
    q0, rate = (
        np.array([0.2, -0.1, 0.1, 0.1, -0.12, 0.2]),
        np.array([0.3, 0.2, -0.1, 0.1, 0.2, 0.1]),
    )
    head, h = geometry_about(station, "cmf"), 1e-4

    def legs(t):
        return pose_to_legs(q0 + t * rate, head)

    reach = reach_along(head, station, q0[None], rate[None])
    jacobian, turning = reach.jacobian, reach.turning
    centroid = pose_to_legs(reach.values[0, 6:], shape)
    np.testing.assert_allclose(reach.values[0, :6], centroid, atol=1e-12)
    np.testing.assert_allclose(jacobian[0, :6] @ rate, (legs(h) - legs(-h)) / (2 * h), atol=1e-7)
    second = (legs(h) - 2 * legs(0.0) + legs(-h)) / h**2
    np.testing.assert_allclose((turning[0] @ rate)[:6], second, atol=1e-6)
    # J' q' is square in q': the straight line from q'* misses (1.5 - 1)^2 of it.
    more = reach_along(head, station, q0[None], 1.5 * rate[None]).turning
    linear = turning[0] @ (2.0 * 1.5 * rate - rate)
    np.testing.assert_allclose(more[0] @ (1.5 * rate), linear + turning[0] @ rate / 4.0, atol=1e-6)
    ahead, behind = (
        reach_along(head, station, (q0 + step * rate)[None], rate[None]).values[0]
        for step in (h, -h)
    )
    np.testing.assert_allclose(jacobian[0] @ rate, (ahead - behind) / (2 * h), atol=1e-6)
