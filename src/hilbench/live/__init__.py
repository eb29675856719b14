"""Diagnosis while the bench runs: a process of its own, which the bench hands its samples and which answers."""
