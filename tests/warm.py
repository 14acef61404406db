"""Fill the compile cache before workers start, so that no worker compiles.

A compilation leaves 30 to 100 MB behind in its process, which a loaded function does not. What
tests call with types of their own, or compile of their own, is called here as they do.

python tests/warm.py table    the loop that follows a table of demands, and what reads its records
python tests/warm.py chain    the loop of the facility, from host to sensors, and motion cueing
"""

import sys

import numpy as np
from cab_motions import level
from protected_records import fault_of

from cmf_mj import Hexapod, signals, simulate
from cmf_mj.control.dcl import make_dcl
from cmf_mj.control.dcu.play import upsample
from cmf_mj.control.dcu.state import load_dcu, make_dcu, resting
from cmf_mj.control.inverse import follow_pose, load_opening
from cmf_mj.control.law import load_law
from cmf_mj.control.protection import load_protection, make_protection
from cmf_mj.control.states import Request, State
from cmf_mj.electronics.chain import gravity_history
from cmf_mj.facility.host import handover
from cmf_mj.facility.replay import replay
from cmf_mj.facility.scenario import load_scenario
from cmf_mj.facility.signal_session import SignalSession
from cmf_mj.machine.leg_motion import leg_motion_to_pose
from cmf_mj.pilot.cueing import within_limits
from cmf_mj.pilot.motion import PilotMotion
from cmf_mj.pilot.perception import sense
from cmf_mj.pilot.washout import Washout
from cmf_mj.plant.cylinder import Cylinder, make_cylinders
from cmf_mj.plant.parameters import load_hydraulics
from cmf_mj.studies.tuning.evaluation import linear_cab, step_response
from tests.control import test_limiter_chain as limit_chain
from tests.control import test_states as operating_states
from tests.facility import test_front as streams
from tests.facility import test_host as host
from tests.plant import test_cylinder as cylinders
from tests.plant import test_friction as frictions
from tests.plant import test_oil as oils
from tests.plant import test_valve as valves


def table() -> None:
    machine = Hexapod()
    step = signals.step("heave", 0.01, at=1 / 2048, duration=4 / 2048)
    record = simulate(machine, "velocity", step)
    replay(record, "velocity")
    fault_of(record, make_protection(load_protection()), 1e7)
    gravity_history(record["leg_position"])
    inverse = make_dcl(load_law("modal_plan").bound_to("gfd"), 6).plan.inverse
    follow_pose(inverse, np.zeros(6))
    load_opening(inverse, 0.1, 0.1, 0.1, 0.1)
    step_response(load_law("velocity"), linear_cab(machine), [0], np.ones(6))
    cylinder = Cylinder(*make_cylinders(load_hydraulics("report"), ["leg"])[0])
    cylinders.test_volume_slopes_are_the_areas(cylinder)
    cylinders.test_force_is_pressure_times_area(cylinder)
    cylinders.test_cushion_is_an_orifice_in_series_with_the_valve()
    frictions.slide(frictions.CONTACT, 0.0, 0.0, 1e-3)
    oils.test_stored_energy_is_the_work_of_filling("report", 2e5)
    valves.lags(valves.valve_of(18.85, 471.2), 0.0, 0.0, 0.0)
    valves.test_opening_is_the_spool_less_the_overlap()


def chain() -> None:
    SignalSession(load_scenario("operate_from_settled")).run(4)
    dcu = make_dcu(load_dcu())
    upsample(dcu, resting(dcu), handover.make_log(1), 1)
    limit_chain.run(np.zeros((2, 6)))
    machine = operating_states.at(State.OFF)
    operating_states.run(machine, [Request.NONE])
    operating_states.test_the_diagram_of_the_documentation_has_every_change_and_no_other()
    live = streams.build(State.ENGAGED, [])
    streams._advance(live, 0, 1, np.zeros(6), 2**40, np.zeros((3, 1, 6)))
    host._read_until(handover.make_ring(2), handover.make_log(1), 0)
    for settings in ("simona", "predictive", "optimal"):
        flown, by_frame = level(0.1), Washout(settings)
        stream = Washout(settings).run(flown)
        for now in zip(flown.specific_force, flown.angular_rate, strict=True):
            by_frame.frame(*now)
    within_limits(stream)
    leg_motion_to_pose(stream.pose, stream.velocity, stream.acceleration)
    sense(PilotMotion.from_platform(stream, np.zeros(3)))


{"table": table, "chain": chain}[sys.argv[1]]()
