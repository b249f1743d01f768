"""The posterior at every rung of `accuracy`, and which record would tell most."""
