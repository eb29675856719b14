"""Simulated CANopen drives for tests of other people's masters: any EDS file of a CiA-402 drive is one."""
