"""What an operator may ask of a running bench, and an experiment too: quantities by path."""
