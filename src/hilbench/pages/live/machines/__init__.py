"""What the page of each kind of machine shows: its plots and its drawing."""
