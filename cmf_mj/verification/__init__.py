"""Cross-verification of the MuJoCo plant by an independent multibody engine.

Needs exudyn, the extra `verification`; nothing else in the package imports this room.
"""

from cmf_mj.verification.machine import Machine, Trajectory
from cmf_mj.verification.study import Run, Verification, valve_sines, verify

__all__ = ["Machine", "Run", "Trajectory", "Verification", "valve_sines", "verify"]
