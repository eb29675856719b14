"""The kinds of machine, each as the twin knows it: the closed model, and what keeps it in step with the measurement."""
