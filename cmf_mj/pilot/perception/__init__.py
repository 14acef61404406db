"""Perception: semicircular canals and otoliths, cueing errors and thresholds."""
