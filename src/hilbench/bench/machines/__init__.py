"""The kinds of machine, each as its list of tasks."""
