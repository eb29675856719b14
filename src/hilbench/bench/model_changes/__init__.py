"""What the diagnosis beside a running bench finds, on its way into the twin: its process, and the task that asks it."""
