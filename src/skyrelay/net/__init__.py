"""HTTP to nodes and stores: bounded in size and time, and silent about credentials."""
