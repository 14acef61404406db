"""System identification from records: data, models, their refinement, fits and validation.

    record -> experiment -> arx | output_error -> PolynomialModel
           -> plant_response -> fit_response -> ResponseFit
    model  -> simulation_fit, residual_analysis; to_continuous -> loop_errors

Everything but the names of channels and axes is plain linear systems theory; no part of it knows
the simulator.
"""
