"""Measures of records and linear models: responses, modes, identification, what was published."""
