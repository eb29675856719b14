"""The bench: config, processes, cycle, tension controller, load-model task, safety."""
