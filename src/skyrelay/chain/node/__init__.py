"""A chain of nodes: the JSON-RPC client and the devnet."""
