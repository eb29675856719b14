"""Synchronizers (estimation methods of E): one method a module, one interface (base)."""
