"""Futures of a web line."""
