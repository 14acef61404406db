"""Linearisation of any plant with its hydraulics at any configuration, as python-control systems.

`linearize` gives the state space from valve commands to what the sensors of the legs read,
`operating_point` the rest it is about, `leg_model`, `dof_model`, `reduced` and `minimal` smaller
systems, `modes` what its poles are. `linear_models.closed_loop` puts a law around it and
`pose_loop` reads that in degrees of freedom; `studies.linear_agreement` checks it.
"""
