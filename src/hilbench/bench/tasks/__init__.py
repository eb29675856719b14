"""What runs in every cycle: load model, controllers, limit watch."""
