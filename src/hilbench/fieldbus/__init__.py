"""CANopen: device runtime (slave side), master, PDO codec, EDS files."""

import hilbench.bus.python_can  # noqa: F401  (before canopen imports python-can in its own way)
