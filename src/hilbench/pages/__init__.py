"""What people see in a browser: the pages of a running bench and of the runs in a folder, and who may see them."""
