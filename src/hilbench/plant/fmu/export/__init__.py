"""Export of machines as FMUs: the compiled kernels, behind a slave in C (FMI 2 and 3, co-simulation)."""
