"""A guest whose kernel has CAN."""
