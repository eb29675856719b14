"""The bench looks ahead: futures from what it has measured, limits announced before they are crossed."""
