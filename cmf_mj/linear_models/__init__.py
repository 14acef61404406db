"""Linear models: the report's by equation number, the DCL as a linear system, both in a loop.

`report_model` gives any transfer function of the report, `leg_plant` joins some into the plant of a
leg, `closed_loop` puts any law around a plant (Figure 4-5), `measure_loop` and `table_4_1` read
bandwidths and damping off it, `feedback_model` and `gain_effect` are the analysis of section 3.4.
"""

from cmf_mj.linear_models.catalogue import (
    HARDWARE_MODELS,
    ReportModel,
    hardware_velocity,
    report_entry,
    report_model,
    report_models,
)
from cmf_mj.linear_models.dcl import DCL_INPUTS, FEEDBACK, dcl_state_space
from cmf_mj.linear_models.loop import closed_loop, loop_response
from cmf_mj.linear_models.measures import (
    LoopMeasures,
    TableRow,
    measure_loop,
    step_response,
    table_4_1,
)
from cmf_mj.linear_models.plants import leg_plant
from cmf_mj.linear_models.second_order import (
    GAINS,
    FeedbackLoop,
    GainEffect,
    LoopCharacteristics,
    bandwidth_example,
    characteristics,
    feedback_model,
    gain_effect,
)
from cmf_mj.linear_models.transfer import UnitTransferFunction

__all__ = [
    "DCL_INPUTS",
    "FEEDBACK",
    "GAINS",
    "HARDWARE_MODELS",
    "FeedbackLoop",
    "GainEffect",
    "LoopCharacteristics",
    "LoopMeasures",
    "ReportModel",
    "TableRow",
    "UnitTransferFunction",
    "bandwidth_example",
    "characteristics",
    "closed_loop",
    "dcl_state_space",
    "feedback_model",
    "gain_effect",
    "hardware_velocity",
    "leg_plant",
    "loop_response",
    "measure_loop",
    "report_entry",
    "report_model",
    "report_models",
    "step_response",
    "table_4_1",
]
