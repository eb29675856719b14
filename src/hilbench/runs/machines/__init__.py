"""The metrics of each kind of machine: a table each, of what all have and what is special."""
