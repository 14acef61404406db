"""Fill the compile cache before workers start, so that no two of them compile the same loop.

python tests/warm.py table    the loop that follows a table of demands
python tests/warm.py chain    the loop of the facility, from host to sensors
"""

import sys

from cmf_mj import Hexapod, signals, simulate
from cmf_mj.facility.scenario.library import load_scenario
from cmf_mj.facility.scenario.run import ScenarioRun

if sys.argv[1] == "table":
    simulate(Hexapod(), "velocity", signals.step("heave", 0.01, at=1 / 2048, duration=4 / 2048))
else:
    ScenarioRun(load_scenario("operate_from_settled")).advance(4)
