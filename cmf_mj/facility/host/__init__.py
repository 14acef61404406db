"""Hosts: platform pose, velocity and acceleration from arrays, files and the network."""
