"""Tuning: search of gains on linear plants of all cabs at once."""
