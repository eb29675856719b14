"""Model changes found by the live diagnosis: its process, and the task that applies them to the twin."""
