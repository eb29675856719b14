"""What an operator asks and is told: objects, notices, changes, causes."""
