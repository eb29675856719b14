"""What a bench is made of: config, parts, signals, settable quantities."""
