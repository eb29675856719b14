"""CANopen: device runtime (slave side), master, PDO codec, EDS files."""

import hilbench.can.python_can  # noqa: F401  (before canopen imports python-can in its own way)
