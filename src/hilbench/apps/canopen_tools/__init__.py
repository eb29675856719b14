"""Work by hand on a CANopen bus: scan, SDO, LSS, boot-up of a network, a drive set in motion."""
