"""What a plain cycle is made of: arrays instead of objects, the compiled functions on them, and the part of a host."""
