"""The machine and its hydraulics a second time, in Exudyn, an independent multibody engine.

Needs the extra `verification`; `python tests/crosscheck` runs it.
"""
