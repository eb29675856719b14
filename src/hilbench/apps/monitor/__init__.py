"""The live monitor: a listener on the bus of a running bench."""
