"""Experiments: steps, criteria, metrics, the Python API."""
