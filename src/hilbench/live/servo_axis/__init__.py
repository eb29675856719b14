"""Diagnosis of a servo axis while its bench runs."""
