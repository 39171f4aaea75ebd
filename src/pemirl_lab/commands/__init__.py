"""One module a command: what it has of its own, and ``run``."""
