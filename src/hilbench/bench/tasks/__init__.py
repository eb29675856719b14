"""Tasks of every cycle: load model, controllers, limit watch."""
