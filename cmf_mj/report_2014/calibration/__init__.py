"""Calibration: which parameters were fitted to which published numbers, and what follows."""
