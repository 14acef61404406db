"""Linear models: the report's by equation number, the DCL as a linear system, both in a loop.

`report_model` gives any transfer function of the report, `leg_plant` joins some into the plant of a
leg, `closed_loop` puts any law around a plant (Figure 4-5), `measure_loop` and `table_4_1` read
bandwidths and damping off it, `feedback_model` and `gain_effect` are the analysis of section 3.4.
"""
