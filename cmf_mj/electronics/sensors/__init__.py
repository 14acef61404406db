"""Sensors: ideal differences of the integrated motion, and instruments with their errors."""
