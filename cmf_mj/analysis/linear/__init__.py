"""Linear models of a plant, the DCL as a linear system, and the loop of both.

`assembly.linearize` gives the state space from valve commands to what the sensors of the legs read,
about the rest of `operating_point`; `plants` has models of one leg, `loop` the DCL without its
clamps around any plant, `poles` stability, damping and modes, `structured` the bound of uncertain
loops. `linear.Linear` is a plant linearised once, with all that is asked of it under any law.
"""
