"""Cross-verification of the MuJoCo plant by an independent multibody engine.

Needs exudyn, the extra `verification`; nothing else in the package imports this room.
"""
