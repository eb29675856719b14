"""What is reported of a run: notices to the operator, what may have led to a fault, what the bench changed."""
