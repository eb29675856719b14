"""The pictures of each kind of machine: a table each."""
