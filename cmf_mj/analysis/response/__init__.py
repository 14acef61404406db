"""Frequency responses from sampled inputs and outputs: estimators with honest bounds."""
