"""Linear models of a plant, the DCL as a linear system, and the loop of both.

`assembly.linearize` gives the state space from valve commands to what the sensors of the legs read,
about the rest of `operating_point`; `poles` makes smaller systems of it and says what its modes
are. `loop` has the DCL without its clamps and closes it around any plant, `plants` has those of a
leg. `linear.Linear` is a plant linearised once, with all that is asked of it under any law.
"""
