"""What the columns of a table mean: names and units of the contract, other instruments, mapping files."""
