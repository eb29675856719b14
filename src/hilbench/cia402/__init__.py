"""CiA-402: state machine, drive object (master side), simulated drive, motor model."""
