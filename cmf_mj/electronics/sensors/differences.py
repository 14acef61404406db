"""Leg sensors, ideal: position, velocity and acceleration from the extension MuJoCo integrates.

MuJoCo's semi-implicit step is a leapfrog: extensions l[k] belong to t[k], and the mean velocity
u[k] = (l[k] - l[k-1]) / h to the middle of the step. Second order in h at t[k]:

    v[k] = u[k] + (u[k] - u[k-1]) / 2,    a[k-1] = (u[k] - u[k-1]) / h

The acceleration is the one of the step just completed: one mechanical step old. Both come from
extensions alone, so that joints and tendons are sensed alike.
"""

from cmf_mj.core.compiled import compiled


@compiled
def velocity(mean, mean_before):  # type: ignore[no-untyped-def]
    """v[k] [m/s] from the mean velocities of the last two steps."""
    return 1.5 * mean - 0.5 * mean_before


@compiled
def acceleration(mean, mean_before, step):  # type: ignore[no-untyped-def]
    """a[k-1] [m/s^2] from the mean velocities of the last two steps."""
    return (mean - mean_before) / step
