"""Immutable parameter sets: each number with its unit, status and source."""
