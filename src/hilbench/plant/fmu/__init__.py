"""Machines from FMUs (Functional Mock-up Units, FMI 2 and 3, co-simulation): read, run in a process of their own."""
