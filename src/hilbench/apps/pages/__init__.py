"""Browser pages of a running bench and of the runs in a folder, and access to them."""
