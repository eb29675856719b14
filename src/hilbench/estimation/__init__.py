"""What changes in a machine, found from torques: balance, synchronizers, detectors."""
