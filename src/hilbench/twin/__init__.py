"""Twin process: virtual axes, virtual I/O, synchronization."""
