"""Findings of the runs of a stand's machine, and how they change from day to day."""
