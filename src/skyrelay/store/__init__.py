"""Models by content address."""
