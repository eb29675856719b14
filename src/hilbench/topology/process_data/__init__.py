"""Process data between the bench and the twin of each kind of machine."""
