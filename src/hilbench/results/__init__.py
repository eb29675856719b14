"""Files of a run: trace, recording, run folder."""
