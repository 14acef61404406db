"""The machine and its hydraulics a second time, in Exudyn, an independent multibody engine.

Needs the extra `verification`; `scripts/verify_plant.py` runs it.
"""
