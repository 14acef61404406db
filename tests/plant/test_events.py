"""Events: what each does, when, and what is refused."""

from typing import Any

import numpy as np
import pytest
from hydraulic_equations import INCH, areas, changed, leakage
from pydantic import ValidationError

from cmf_mj import Hexapod, Record, SingleLegs, simulate
from cmf_mj.facility.simulate import drive
from cmf_mj.plant.events import KINDS, Event, make_timeline

LBF = 0.45359237 * 9.80665
LOCAL = tuple(k for k in KINDS if k.startswith(("valve", "sensor")))


def driven(*events: Event, commands: np.ndarray | None = None, **numbers: Any) -> Record:
    """Single legs for 2 s with valves at null, or as commanded."""
    table = np.zeros((4096, 6)) if commands is None else commands
    return drive(SingleLegs(changed("hardware", **numbers)), table, events=events)


def moving() -> np.ndarray:
    """Leg commands that sway slowly."""
    return np.tile(0.1 * np.sin(np.arange(4096) / 2048 * 2 * np.pi)[:, None], (1, 6))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("frame", [0, 1000])
def test_nothing_changes_before_an_event_and_something_after(kind: str, frame: int) -> None:
    """Bit for bit the same up to the row of its frame. Closed loop, so that sensors matter."""
    event = Event(at=frame / 2048, kind=kind, leg=2 if kind in LOCAL else None)
    demand = 0.05 * np.sin(np.arange(3000) / 2048 * 6.0)[:, None] * np.ones(6)
    plain, failed = (
        simulate(SingleLegs(), "velocity", demand, legs=True, events=e) for e in ((), (event,))
    )
    channels = [name for name in plain.channels if name != "gimbal_error"]
    for name in channels:
        np.testing.assert_array_equal(plain[name][:frame], failed[name][:frame], err_msg=name)
    assert any((plain[n][frame:] != failed[n][frame:]).any() for n in channels)
    assert failed.metadata["events"][0]["kind"] == kind


def test_pump_lost() -> None:
    """The flow dies with the compensator's 0.05 s; accumulators alone feed the legs."""
    record = driven(Event(at=0.5, kind="pump_lost"), commands=moving())
    flow = record["pump_flow"]
    assert flow[1024] > 1e-4
    assert flow[1024 + 512] == pytest.approx(flow[1024] * np.exp(-0.25 / 0.05), rel=0.05)
    assert flow[-1] < 1e-9
    assert (np.diff(record["accumulator_oil"][1500:]) <= 0.0).all()


@pytest.mark.parametrize(("size", "end"), [((100.0, "%"), 1.0), ((-0.5, "1"), -0.5)])
def test_valve_hard_over(size: tuple[float, str], end: float) -> None:
    """The spool goes to its end; with one valve the opening's mean goes half-way."""
    both = driven(Event(at=0.1, kind="valve_hard_over", leg=3, size=size))
    one = driven(Event(at=0.1, kind="valve_hard_over", leg=3, valve=2, size=size))
    assert both["valve_opening"][600, 2] == pytest.approx(end, rel=1e-3)
    assert one["valve_opening"][600, 2] == pytest.approx(end / 2, rel=1e-3)
    assert not both["valve_opening"][:, [0, 1, 3, 4, 5]].any()
    assert np.sign(both["leg_velocity"][600, 2]) == np.sign(end)


def test_valve_jammed_and_dead() -> None:
    """Jammed, the opening stays where it was; dead, it goes to null."""
    jammed = driven(Event(at=0.25, kind="valve_jammed", leg=1), commands=moving())
    stays = jammed["valve_opening"][513:, 0]
    assert abs(stays[0]) > 0.05
    np.testing.assert_array_equal(stays, stays[0])
    dead = driven(Event(at=0.25, kind="valve_dead", leg=1), commands=moving())
    assert abs(dead["valve_opening"][1400, 0]) < 1e-6
    assert abs(dead["valve_opening"][1400, 1]) > 0.01


def test_sensors() -> None:
    """What the DCL reads against what is true."""
    for kind, size in (("sensor_stuck", None), ("sensor_offset", (2.0, "in"))):
        record = driven(Event(at=0.25, kind=kind, leg=4, size=size), commands=moving())
        read, true = record["leg_position"][512:, 3], record["leg_extension"][512:, 3]
        if kind == "sensor_stuck":
            assert np.ptp(read) == 0.0
            assert read[0] == pytest.approx(true[0], abs=1e-3)
        else:
            np.testing.assert_allclose(read - true, 2 * INCH, rtol=1e-12)
    record = driven(Event(at=0.25, kind="sensor_open", leg=4), commands=moving())
    np.testing.assert_array_equal(record["leg_position"][512:, 3], -38 * INCH)
    np.testing.assert_array_equal(record["leg_position"][:, 0], record["leg_extension"][:, 0])


@pytest.mark.parametrize("kind", ["single_legs", "hexapod"])
def test_emergency_stop_settles_the_platform_at_the_computed_speed(kind: str) -> None:
    """The valves are shut off in 0.1 s. The cap drains through an orifice that passes settle_speed
    under settle_load, p0 = F0 / Ac, into the tank, and through the piston's leakage L:
    v = v0 sqrt(p_cap / p0) + L (p_cap - p_rod) / Ac. 1.5 %: oil's compression, return pressure."""
    plant = SingleLegs() if kind == "single_legs" else Hexapod("ifd")
    commands = np.full((3 * 2048, 6), 0.5)
    record = drive(plant, commands, events=[Event(at=0.2, kind="emergency_stop")])
    p = plant.parameters
    cap_area, _ = areas(p)
    late = slice(2 * 2048, 3 * 2048)
    cap, rod = (record[f"{side}_pressure"][late].mean(axis=0) for side in ("cap", "rod"))
    speed = -record["leg_velocity"][late].mean(axis=0)
    expected = p.settle_speed.si * np.sqrt(cap * cap_area / p.settle_load.si)
    expected += leakage(p) * (cap - rod) / cap_area
    np.testing.assert_allclose(speed, expected, rtol=1.5e-2)
    assert record["isolation"][410] == pytest.approx(0.0, abs=0.01)
    assert record["isolation"][410 + 210] == 1.0


# Settings


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"kind": "fire"}, "kind"),
        ({"kind": "pump_lost", "at": -1.0}, "at"),
        ({"kind": "valve_dead"}, "leg: is missing; valve_dead needs the leg it happens to"),
        ({"kind": "pump_lost", "leg": 2}, "leg: 2 is not allowed; pump_lost has no leg"),
        ({"kind": "sensor_stuck", "leg": 1, "valve": 1}, "valve: 1 is not allowed"),
        ({"kind": "valve_dead", "leg": 1, "valve": 3}, "valve"),
        ({"kind": "valve_dead", "leg": 0}, "leg"),
        ({"kind": "pump_lost", "size": (1.0, "1")}, "is not allowed; pump_lost has none"),
        ({"kind": "overload", "size": (1.0, "in")}, "size: unit 'in' is not one of lbf, N"),
        ({"kind": "overload", "size": (-1.0, "N")}, "size: -1 N must be greater than 0 N"),
        ({"kind": "valve_hard_over", "leg": 1, "size": (150.0, "%")}, "at most 100 % either way"),
        ({"kind": "accumulator_lost", "size": (0.5, "1")}, "size: 0.5 1 must be a whole number"),
    ],
)
def test_refusals_name_the_field(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError) as caught:
        Event(**({"at": 1.0} | fields))
    assert message in str(caught.value)


def test_a_leg_that_is_not_there_is_refused() -> None:
    event = Event(at=0.0, kind="valve_dead", leg=7)
    with pytest.raises(ValueError, match="leg: 7 of valve_dead is not a leg; allowed: 1 to 6"):
        drive(SingleLegs(), np.zeros((4, 6)), events=[event])


def test_sizes_have_defaults_and_units() -> None:
    for fields, size in (
        ({"kind": "overload"}, 10_000 * LBF),
        ({"kind": "overload", "size": (5.0, "N")}, 5.0),
        ({"kind": "supply_hose_burst"}, INCH**2),
        ({"kind": "pump_lost"}, 0.0),
        ({"kind": "sensor_open", "leg": 1, "size": (2.0, "in")}, 2 * INCH),
    ):
        assert Event(at=0.0, **fields).magnitude(0.5) == pytest.approx(size, rel=1e-12)


@pytest.mark.parametrize(("machine", "half_stroke"), [("cmf", 38 * INCH), ("simona", 0.575)])
def test_an_open_sensor_reads_the_lower_end_of_its_own_leg(
    machine: str, half_stroke: float
) -> None:
    plant = Hexapod(machine=machine)
    event = Event(at=0.01, kind="sensor_open", leg=4)
    record = drive(plant, np.zeros((64, 6)), events=[event])
    np.testing.assert_array_equal(record["leg_position"][21:, 3], -half_stroke)
    assert event.magnitude(half_stroke) == -half_stroke


def test_a_timeline_is_in_order_of_time_and_events_add_up() -> None:
    events = [
        Event(at=0.3, kind="overload", size=(100.0, "N")),
        Event(at=0.1, kind="valve_dead", leg=2, valve=1),
        Event(at=0.1, kind="overload", size=(50.0, "N")),
    ]
    timeline = make_timeline(events, np.full(6, 0.5))
    assert list(timeline.frame) == [205, 205, 614]
    assert [KINDS[k] for k in timeline.kind] == ["valve_dead", "overload", "overload"]
    assert (list(timeline.leg), list(timeline.valve)) == ([1, -1, -1], [0, -1, -1])
    record = driven(*events, leak_rate=100.0)
    more = record["leg_force"][-600:].mean() - record["leg_force"][0].mean()
    assert more == pytest.approx(25.0, rel=5e-2)
