"""Fill the compile cache before workers start, so that no two of them compile the same loop.

A compilation also leaves some 100 MB behind in its process, which a worker then would not have.

python tests/warm.py table    the loop that follows a table of demands, and both washouts
python tests/warm.py chain    the loop of the facility, from host to sensors
"""

import sys

from flights import level

from cmf_mj import Hexapod, signals, simulate
from cmf_mj.facility.scenario.library import load_scenario
from cmf_mj.facility.scenario.run import ScenarioRun
from cmf_mj.pilot.cueing.washout import Washout

if sys.argv[1] == "table":
    simulate(Hexapod(), "velocity", signals.step("heave", 0.01, at=1 / 2048, duration=4 / 2048))
    for settings in ("simona", "optimal"):
        Washout(settings).run(level(0.1))
else:
    ScenarioRun(load_scenario("operate_from_settled")).advance(4)
