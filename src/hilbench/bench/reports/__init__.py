"""Reports of a run: notices to the operator, possible causes of a fault, changes by the bench."""
