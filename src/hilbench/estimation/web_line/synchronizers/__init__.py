"""Synchronizers: one method a module, one interface (base)."""
