"""The machine and its hydraulics a second time, in Exudyn, an independent multibody engine.

Needs the extra `verification`. `cmf verify` runs it from a checkout; the wheel does not hold it.
"""
