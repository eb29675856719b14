"""hilbench: a hardware-in-the-loop test bench over CAN/CANopen with a synchronized twin."""
