"""`hilbench doctor`: what of machine, interface and nodes is as the bench needs it, and what to do where it is not."""
