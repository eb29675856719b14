"""Cycles of a bench in one process in which nothing but set points and feedback changes, run compiled."""
