"""Traces under the picture of a run: the degree of freedom that moves most, a leg's pressures."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core import units
from cmf_mj.machine.geometry import DOFS, dof_unit
from cmf_mj.record.record import Record
from cmf_mj.show.look import BLUE, DARK, GREEN, GREY, ORANGE, Curve, Panel

Panels = Sequence[Panel]  #: What stands under the picture of one run, from above.

_LEAST_RANGE = 0.02  #: Least range of an axis, in its unit.


def busiest_leg(*records: Record) -> int:
    """The leg, from 0, whose cap pressure moves most in any of the records."""
    ranges = [np.ptp(record["cap_pressure"], axis=0) for record in records]
    return int(np.max(ranges, axis=0).argmax())


def traces_of(record: Record, leg: int | None = None) -> Panels:
    """A degree of freedom of a record, and pressures of a leg [psi], the busiest by default.

    The degree of freedom is the one whose demand, or without one whose response, moves most,
    lengths against 1 in and angles against 1 deg.
    """
    leg = busiest_leg(record) if leg is None else leg

    def curve(
        name: str, channel: str, column: int, unit: str, colour: str, width: float = 1.0
    ) -> Curve:
        values = record[channel].reshape(record.time.size, -1)[:, column]
        return Curve(name, record.time, values / units.factor(unit), colour, width=width)

    title, column, unit = f"leg {leg + 1}", leg, "in"
    demand, response = "leg_reference", "leg_extension"
    if "platform_pose" in record.channels:
        demand, response = "demand_pose", "platform_pose"
        scale = np.array([units.factor(dof_unit(dof)) for dof in DOFS])
        pose = record.channels.get(demand, record[response]) / scale
        column = int(np.ptp(pose, axis=0).argmax())
        title, unit = DOFS[column], dof_unit(column)
    motion = [curve("response", response, column, unit, BLUE, 1.2)]
    if demand in record.channels:
        motion.insert(0, curve("demand", demand, column, unit, GREY, 2.2))
    pressures = (
        curve("cap", "cap_pressure", leg, "psi", ORANGE),
        curve("rod", "rod_pressure", leg, "psi", GREEN),
        curve("supply", "supply_pressure", 0, "psi", DARK),
    )
    pressure_panel = Panel(f"leg {leg + 1} [psi]", pressures, from_zero=True)
    return Panel(f"{title} [{unit}]", tuple(motion)), pressure_panel


def samples_within(
    curve: Curve, span: tuple[float, float]
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Times and values of a curve within a span of time; at its ends where no sample is in it."""
    inside = (curve.x >= span[0]) & (curve.x <= span[1])
    if inside.any():
        return curve.x[inside], curve.y[inside]
    return np.array(span), np.interp(span, curve.x, curve.y)


def limits_of(panels: Panels, span: tuple[float, float]) -> tuple[float, float]:
    """Ends of an axis that holds the curves of all panels within a span of time."""
    curves = [curve for panel in panels for curve in panel.curves]
    values = np.concatenate([samples_within(curve, span)[1] for curve in curves])
    low, high = float(values.min()), float(values.max())
    if panels[0].from_zero:
        return min(0.0, low), max(1.08 * high, _LEAST_RANGE)
    margin = 0.08 * max(high - low, _LEAST_RANGE)
    return low - margin, high + margin
