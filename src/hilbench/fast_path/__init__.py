"""The fast path: arrays instead of objects, compiled functions on them, and a device host's part of a cycle."""
