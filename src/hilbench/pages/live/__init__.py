"""The page of a running bench: a listener on its bus, what it has heard, and who controls."""
