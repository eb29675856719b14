"""What an operator asks for, and what is reported: objects, notices, changes, causes."""
