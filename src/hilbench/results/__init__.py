"""What a run leaves behind: trace, recording, run folder."""
