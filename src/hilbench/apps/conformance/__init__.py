"""Conformance of CANopen devices, ours and others': what is sent, expected and seen, case by case."""
