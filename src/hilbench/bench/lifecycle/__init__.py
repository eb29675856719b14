"""Start-up to a running bench, and return to the safe state."""
