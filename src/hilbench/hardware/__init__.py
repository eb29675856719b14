"""The simulated hardware: drives on their plant, a process of its own."""
