"""Programs that a person starts: a folder for each, with its command, its pages and its templates."""
