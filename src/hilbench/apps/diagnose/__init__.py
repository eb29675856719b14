"""Diagnosis of a recording, or of a bench that is run for it."""
