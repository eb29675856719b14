"""The runs in a folder: found, told from each other, labelled, compared and cleared away."""
