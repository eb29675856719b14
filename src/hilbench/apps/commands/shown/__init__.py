"""What the terminal shows of a run, by kind of machine."""
