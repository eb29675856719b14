"""The fault matrix: what is done to a run, what came of it, and the table."""
