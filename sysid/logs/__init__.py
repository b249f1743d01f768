"""From a file to a `Log`: text, cells, units and column names, other instruments, raw carriers."""
