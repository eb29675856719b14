"""Bench topology: config, parts, signals, settable quantities."""
