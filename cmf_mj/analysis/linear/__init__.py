"""Linear models of leg and plant, the DCL as a linear system, and the loop of both.

The report's models: `catalogue` has them by equation number, `plants` joins some into the plant of
a leg, `second_order` is the analysis of section 3.4, `table_4_1` computes that table.

Our plants: `assembly.linearize` gives the state space from valve commands to what the sensors of
the legs read, about the rest of `operating_point`; `reduction` makes smaller systems of it, `poles`
says what its modes are, `files` keeps it.

`law` is the DCL without its clamps, `loop` closes it around any of them. `linear.Linear` is a plant
linearised once, with all that is asked of it under any law.
"""
