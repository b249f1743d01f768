"""The plant, exact, and the likelihood of a log with every nuisance eliminated."""
