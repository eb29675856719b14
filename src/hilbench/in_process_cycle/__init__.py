"""Fast path of a bench in one process: compiled cycles in which only set points and feedback change."""
