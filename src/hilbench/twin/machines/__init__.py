"""Machines of the twin by kind: the closed model, and its estimator from measurements."""
