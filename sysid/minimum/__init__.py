"""Starting points, and the minimum that they lead to: a `State`."""
