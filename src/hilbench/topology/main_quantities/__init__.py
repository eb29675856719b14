"""The quantities of each kind of machine that a person changes and watches: what they are called, and in which unit."""
