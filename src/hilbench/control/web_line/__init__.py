"""Tension controllers of a web line: PI, swing damping, strain trajectory, feed-forward of forces."""
