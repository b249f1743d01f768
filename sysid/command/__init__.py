"""The command `identify`: its arguments, its budget, what it writes."""
