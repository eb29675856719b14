"""Parameter estimation of a machine from torques: momentum balance, synchronizers, change detectors."""
