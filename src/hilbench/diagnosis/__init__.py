"""Diagnosis of recordings: gap between simulation and measurement, the missing effects, and the model with them."""
