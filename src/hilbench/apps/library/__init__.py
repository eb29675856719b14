"""The runs in a folder: found, distinguished, labelled, compared and cleared away."""
