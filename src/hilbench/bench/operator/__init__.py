"""Requests to a running bench, by an operator or an experiment: quantities by path."""
