"""Simulated CANopen drives for tests of other people's masters: any EDS file of a CiA-402 drive is one."""

import hilbench.can.python_can  # noqa: F401  (before canopen imports python-can in its own way)
