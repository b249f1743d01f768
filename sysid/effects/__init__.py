"""Effects that a fit adopts where the logs call for them: each says what it does to a log, in one place."""
