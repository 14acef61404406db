"""Runs and modes as off-screen films."""
