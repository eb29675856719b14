"""Futures of a running bench under changed set points."""
