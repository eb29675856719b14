"""Page of a running bench: a listener on its bus, its received signals, and the control lock."""
