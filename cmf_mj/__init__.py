"""cmf-mj: a physically faithful model of NASA Langley's Cockpit Motion Facility in MuJoCo."""

from cmf_mj.control import Law, law_names, load_law
from cmf_mj.frequency_response import FrequencyResponse, bandwidths, frequency_response
from cmf_mj.kinematics import legs_to_pose, pose_to_legs
from cmf_mj.parameters import load_hydraulics
from cmf_mj.plant import Hexapod, Plant, SingleLegs, attach_hydraulics
from cmf_mj.record import Record
from cmf_mj.signals import Command
from cmf_mj.simulation import drive, simulate
from cmf_mj.step_response import StepMetrics, step_metrics
from cmf_mj.studies import compare

__all__ = [
    "Command",
    "FrequencyResponse",
    "Hexapod",
    "Law",
    "Plant",
    "Record",
    "SingleLegs",
    "StepMetrics",
    "attach_hydraulics",
    "bandwidths",
    "compare",
    "drive",
    "frequency_response",
    "law_names",
    "legs_to_pose",
    "load_hydraulics",
    "load_law",
    "pose_to_legs",
    "simulate",
    "step_metrics",
]
