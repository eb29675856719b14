"""FMUs (Functional Mock-up Units, FMI 2 and 3, co-simulation) as machines: read, and run in a separate process."""
