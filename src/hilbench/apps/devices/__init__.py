"""Simulated CANopen drives for tests of other people's masters: any EDS file of a CiA-402 drive is one."""

from hilbench.apps.devices.drive import SimulatedDrive

__all__ = ["SimulatedDrive"]
