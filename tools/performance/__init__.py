"""The parts of `make bench`: each measures one thing beside what one would use instead."""
