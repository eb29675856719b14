"""Synchronizers compared, on a recording or on a bench."""
