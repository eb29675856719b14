"""The twin process: virtual axes, virtual I/O, synchronization."""
