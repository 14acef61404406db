"""Calibration: which parameters were fitted to which published numbers, and what that is worth.

`load_study` gives a study, `calibrate` fits its free parameters, `residual_rows` puts every
printed number next to a computed one, `sensitivity` and `spread` say what a result owes to each
parameter and how far their ranges carry it.
"""
