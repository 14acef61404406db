"""Scenarios: runs as files, live runs that can be changed, and files of what was done live."""
