"""Web mechanics and effects: the one model kernel, its parameters and noise."""
