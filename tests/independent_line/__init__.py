"""A web line of two driven rollers, simulated with other equations than the product's: see `line`."""

from tests.independent_line.line import PROFILES, STEP_OF_E, Courses, Line, Loops, Record, effect

__all__ = ["PROFILES", "STEP_OF_E", "Courses", "Line", "Loops", "Record", "effect"]
