"""From nothing to a running bench, and back to the safe state."""
