"""Page contents of each kind of machine: its plots and its drawing."""
