"""What comes next: futures of a machine from its present state, much faster than they pass."""
