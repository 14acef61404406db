"""Calibration: which parameters were fitted to which published numbers, and what that is worth."""
