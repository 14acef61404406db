"""Scenarios: runs as files, live runs that can be changed, and files of what was done live."""

from cmf_mj.scenario.library import find_scenario, scenario_names
from cmf_mj.scenario.run import Live, ScenarioRun, make_plant, run_scenario
from cmf_mj.scenario.settings import (
    Change,
    ElectronicsChoice,
    Failure,
    OperationChoice,
    Outputs,
    Push,
    Scenario,
    VideoChoice,
    change_of,
    load_scenario,
    read_scenario,
    save_scenario,
    scenario_of,
    scenario_toml,
)
from cmf_mj.scenario.signal import Signal

__all__ = [
    "Change",
    "ElectronicsChoice",
    "Failure",
    "Live",
    "OperationChoice",
    "Outputs",
    "Push",
    "Scenario",
    "ScenarioRun",
    "Signal",
    "VideoChoice",
    "change_of",
    "find_scenario",
    "load_scenario",
    "make_plant",
    "read_scenario",
    "run_scenario",
    "save_scenario",
    "scenario_names",
    "scenario_of",
    "scenario_toml",
]
