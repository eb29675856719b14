"""A web line: its gap, its models, what is tried and when."""
