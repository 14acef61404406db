"""cmf-mj: a physically faithful model of NASA Langley's Cockpit Motion Facility in MuJoCo."""

from cmf_mj.analysis.frequency_response import FrequencyResponse, bandwidths, frequency_response
from cmf_mj.analysis.step_response import StepMetrics, step_metrics
from cmf_mj.control.law import Law, law_names, load_law
from cmf_mj.core.errors import CmfError, InputError, MissingExtraError, RunError
from cmf_mj.facility.simulation import drive, simulate
from cmf_mj.machine.kinematics import legs_to_pose, pose_to_legs
from cmf_mj.plant.attach import attach_hydraulics
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters.loading import load_hydraulics
from cmf_mj.plant.plant import Plant
from cmf_mj.plant.single_legs import SingleLegs
from cmf_mj.record.record import Record
from cmf_mj.signals.single import Command
from cmf_mj.studies.comparison import compare

__all__ = [
    "CmfError",
    "Command",
    "FrequencyResponse",
    "Hexapod",
    "InputError",
    "Law",
    "MissingExtraError",
    "Plant",
    "Record",
    "RunError",
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
