"""Futures of a servo axis."""
