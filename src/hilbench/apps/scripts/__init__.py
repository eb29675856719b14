"""The bench for scripts, notebooks and pytest."""
