"""The compiled frame loop and the blocks around the control law."""
