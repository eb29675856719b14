"""Prediction of a web line's measurements: freely, or on measured motion."""
