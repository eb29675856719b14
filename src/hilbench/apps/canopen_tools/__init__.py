"""What is done by hand on a CANopen bus: scan, SDO, LSS, boot-up of a network, a drive set in motion."""

import hilbench.can.python_can  # noqa: F401  (before canopen imports python-can in its own way)
