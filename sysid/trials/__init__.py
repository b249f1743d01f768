"""A `Trial`: one log as it is read, its noise, and what the bench added, as they are known so far."""
