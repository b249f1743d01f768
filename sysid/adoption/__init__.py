"""Effects that logs call for: found, fitted and adopted."""
