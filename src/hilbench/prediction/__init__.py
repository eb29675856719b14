"""Prediction: futures of a machine simulated from its present state, much faster than real time."""
