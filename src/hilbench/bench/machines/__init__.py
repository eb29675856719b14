"""The kinds of machine, each as the list of tasks that it is to the bench."""
