"""Access to a CANopen network from other networks: the ASCII mapping of CiA 309-3 over TCP."""
