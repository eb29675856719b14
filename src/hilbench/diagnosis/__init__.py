"""Where simulation and measurement disagree, which effect is missing, and the model with it."""
