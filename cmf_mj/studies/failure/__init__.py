"""Failure study: one event during a manoeuvre, what the legs and the crew feel, how it ends."""
