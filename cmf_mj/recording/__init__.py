"""Recordings: the facility's CSV files at 128 Hz, and UFF 58."""

from cmf_mj.recording.layout import BLOCK, BLOCK_WIDTH, LAYOUT, LEGS, RATE, REQUIRED, Group
from cmf_mj.recording.reader import read_facility_csv
from cmf_mj.recording.uff import read_uff, write_uff
from cmf_mj.recording.writer import write_facility_csv

__all__ = [
    "BLOCK",
    "BLOCK_WIDTH",
    "LAYOUT",
    "LEGS",
    "RATE",
    "REQUIRED",
    "Group",
    "read_facility_csv",
    "read_uff",
    "write_facility_csv",
    "write_uff",
]
