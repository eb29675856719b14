"""Control laws of machines: compiled, with their state in records, a cycle or a step of a prediction at a time."""
