"""Failure study: one event during a manoeuvre, what the legs and the crew feel, how it ends.

The manoeuvre is a sine in one degree of freedom from rest to rest. The event strikes at a set
time; with protection on, the first detected fault makes an emergency stop.
"""
