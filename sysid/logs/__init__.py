"""From the columns of files to a `Log`, and back."""
