"""What runs have found of a stand's machine, and how it changes from day to day."""
